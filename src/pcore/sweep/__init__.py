"""Many trials from one plan: in turn or on Ray, resumable, gathered into one table."""
