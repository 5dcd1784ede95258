"""Settings files: their tables, messages, changes on the command line, and the page that documents them."""
