"""The report of a run: one page for people, and its pictures as files."""
