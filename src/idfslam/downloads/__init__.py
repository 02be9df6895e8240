"""Downloads of public sequences: their catalogue, resumable HTTP, safe unpacking."""
