"""Compare scans of printed blocks with their formulas.

Import the names from this module. Each name is loaded when it is first used, so the import is fast::

    from tacbench_cad.extensions.scan import analyse, read_scan

* a scan: :func:`read_scan`, :class:`Cloud`; without a scanner: :func:`simulate_scan`, :class:`ScanTruth`
* its result: :func:`analyse`, :class:`ScanOptions`, :class:`Limits`, :class:`ScanResult`, :func:`write_result`
* only the fit: :func:`fit_scan`, :func:`identify`, :class:`ScanFit`, :class:`Pose`
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
