"""Virtual firmware that behaves like GRBL, grblHAL, Marlin and the paper's Arduino sketch, and a load cell.

Import the names from this package. Each is loaded at its first use::

    from tacbench_cad.extensions.virtual_rig import Fault, launch

* :func:`launch` starts a virtual rig (:class:`VirtualRig`), which accepts each :class:`Fault`.

The modules inside: ``machine`` moves a carriage in rig time; ``grbl``, ``marlin`` and ``arduino`` are state machines
with bytes as input and output; ``board`` connects one to a serial line of a given speed and applies ``faults``;
``loadcell`` sends samples; ``server`` and ``transport`` provide pseudo-terminals or TCP ports. ``drivers`` are
the drivers ``virtual-grbl``, ``virtual-marlin`` and ``virtual-serial`` of study files.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
