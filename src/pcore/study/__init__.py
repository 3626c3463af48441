"""User studies: blind choices between pictures of two methods, and what the answers say."""
