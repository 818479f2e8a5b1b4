"""Open CASCADE solids of blocks from their formulas, and proved bounds of the error of these solids."""
