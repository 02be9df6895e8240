"""What moves: found in each frame, tried with the frame's pose, and looked for again at the end."""
