"""The light half: pressing blocks, keeping what was read, and analysing it. Imports no CAD package.

``spec`` names things; ``study`` reads them from a TOML file; ``presses`` puts them in order; ``rig`` drives devices;
``acquire`` presses; ``runs`` keeps; ``simulate`` stands in for hardware; ``authors`` imports the paper's arrays.
"""
