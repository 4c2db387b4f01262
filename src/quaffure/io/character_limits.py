"""What files of characters may hold, whatever their format: they come from anywhere."""

FREE_BYTES = 2**29
"""What the arrays of any file may take [bytes]; beyond it at most `MOST_COMPRESSION` times the size of the file."""
MOST_COMPRESSION = 64
MOST_NODES = 2**16
LARGEST_NUMBER = 1e9
LAST_SECOND = 1e6  # of an animation
