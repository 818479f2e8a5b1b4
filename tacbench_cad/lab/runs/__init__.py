"""Run folders: one printed block, pressed once through its protocol, in the layout of the TacTip toolchains."""
