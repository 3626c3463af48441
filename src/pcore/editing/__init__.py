"""Edit files and what applies them."""
