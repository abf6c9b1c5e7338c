"""What every stage needs: errors, files, processes, terminal; tables, indices, colors, portable arithmetic."""
