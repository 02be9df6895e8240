"""Back ends: what a new keyframe sets off, the map's updates between keyframes, and the polish at the end."""
