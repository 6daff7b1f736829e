"""The search: archives, evolution strategies and quality-diversity algorithms."""
