"""The simulated rig: virtual printers, a simulated TacTip, whole studies, and firmware that speaks over a port."""
