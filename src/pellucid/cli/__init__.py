"""The command line: one file, one command; nothing heavy is imported before a command runs."""
