"""The design page: its state and its pictures (model), its texture files (document) and its messages (app)."""
