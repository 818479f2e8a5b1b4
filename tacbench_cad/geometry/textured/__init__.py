"""Textures on faces of parts of others: exact spline faces instead of a region of the face."""
