"""Pictures and video of draped hair, drawn offscreen by OpenGL."""
