"""The watch page: its contents (model), its messages (app), and its connection to ``tacbench acquire`` (link)."""
