"""One page on a study."""
