"""Files: atomic writing, reading within limits, layouts, tables, arrays."""
