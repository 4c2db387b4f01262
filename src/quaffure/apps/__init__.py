"""What people run: the command line, pictures and video, and the live page."""
