"""Press printed blocks with a sensor, store the frames, and analyse them. Nothing here imports a CAD package.

Import the names from this module. Each name is loaded when it is first used, so the import is fast::

    from tacbench_cad.lab import Collection, Run, read_study, simulate_study, variance

* a study: :func:`read_study`, :class:`Study`, :class:`Protocol`, :func:`plan_presses`
* a rig: :func:`open_rig`, :class:`Stage`, :class:`Gauge`, :class:`Sensor`, :class:`RigError`
* a data run with a rig: :func:`acquire_study`; without hardware: :func:`simulate_study`
* the run folders: :class:`Run`, :func:`find_runs`, :func:`check_run`
* other people's frames as run folders: :func:`import_samples`
* the sensor's region in an image: :func:`find_region`
* the analysis: :class:`Collection`, :func:`variance`, :func:`grade`, :func:`classify`, :func:`compare`
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
