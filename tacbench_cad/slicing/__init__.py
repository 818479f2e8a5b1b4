"""The way from a part to a print: plates for printers, G-code of slicers, and the surface that will be printed."""
