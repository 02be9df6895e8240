"""What file managers of desktops put into folders on their own: it is nobody's, and no part of a recording."""

NAMES = frozenset({".DS_Store", "Thumbs.db", "desktop.ini", "__MACOSX"})
