"""Objects in the browser: a page that edits one, and a file that shows one."""
