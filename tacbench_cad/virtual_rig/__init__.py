"""Virtual firmware: processes that speak GRBL, grblHAL, Marlin and the authors' Arduino protocol, and a load cell.

``machine`` moves a carriage in rig time; ``grbl``, ``marlin`` and ``arduino`` are state machines, bytes in and bytes
out; ``board`` puts one on a serial line of a given speed and spoils it by ``faults``; ``loadcell`` streams samples;
``server`` and ``transport`` carry both over pseudo-terminals or TCP; ``launch`` starts the process.
"""
