"""Views of a map as sharp as the recording: images of the recording are kept beside the map, and blended over its surface."""
