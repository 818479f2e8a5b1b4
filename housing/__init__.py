"""The printed fixtures around the blocks: holder, grid-marker jig and fit coupon.

Numbers and reports need the base install only; shapes are built with build123d, imported where they are built.
"""
