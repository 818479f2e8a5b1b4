"""Run folders. A run is one pass of the protocol over one printed block, stored in the layout of TacTip toolchains."""
