"""Fuzzing: small valid files of every kind that is read are damaged at random, and nothing but an IdfSlamError may come out.

`make fuzz` runs many (`python -m fuzz`); `tests/test_fuzz.py` runs a few of each. A target (`targets.py`) makes the valid files and uses
them. A mutation (`mutations.py`) is decided by its number alone, so that `python -m fuzz --targets NAME --only NUMBER` repeats one.
"""
