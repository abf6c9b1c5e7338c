"""What every stage needs and no stage is about: errors, files, processes, terminal, TOML, code hashes."""
