"""Virtual firmware: processes that speak GRBL, grblHAL, Marlin and the authors' Arduino protocol, and a load cell.

Import from here; every name is loaded when it is first used::

    from tacbench_cad.virtual_rig import Fault, launch, open_rig

* :func:`launch` starts a virtual rig (:class:`VirtualRig`), to which a :class:`Fault` can be given;
* :func:`open_rig` opens any mixture of real, virtual and simulated devices.

Inside, ``machine`` moves a carriage in rig time; ``grbl``, ``marlin`` and ``arduino`` are state machines, bytes in and
bytes out; ``board`` puts one on a serial line of a given speed and spoils it by ``faults``; ``loadcell`` streams
samples; ``server`` and ``transport`` carry both over pseudo-terminals or TCP; ``process`` starts the process.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
