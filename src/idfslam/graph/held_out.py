"""Frames that are kept from all that views are made of, so that rendered views can be compared with them."""


def is_held_out(index: int, every: int) -> bool:
    """Whether the frame of an index is one of every `every` frames that are held out; 0: none is. The first frame never is."""
    return every > 0 and index % every == every - 1
