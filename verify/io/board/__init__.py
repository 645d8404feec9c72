"""Board pictures on disk: the folder and the pictures in it."""
