"""Random textured scenes with exact poses, depth and instance masks, ray-cast on the fly."""
