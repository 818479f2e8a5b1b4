"""A motion in contact after a press: a slide, during which frames and forces are recorded."""
