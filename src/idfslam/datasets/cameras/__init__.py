"""The camera of a recording: its values, the files that state them, and whether they are plausible."""
