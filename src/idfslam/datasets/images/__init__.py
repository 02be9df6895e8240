"""Images in files, arrays and videos: finding, pairing, decoding, and bringing depth to the colour camera."""
