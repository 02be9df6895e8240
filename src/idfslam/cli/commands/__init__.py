"""One command of the command line a file: its flags, and the call that it makes. Heavy imports happen in the call."""
