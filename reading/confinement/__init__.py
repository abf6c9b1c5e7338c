"""Keep a process that reads other people's files to the folders it needs."""
