"""What printers do to a part: slicers' files read back, and the surface that they will leave."""
