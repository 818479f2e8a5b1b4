"""The simulated rig: virtual printers, a simulated TacTip, and whole simulated studies."""
