"""From an image to marks on a lattice. The public functions of `_detect` are those of the room."""
