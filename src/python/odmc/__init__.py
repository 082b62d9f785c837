"""Online dynamic-model calibration of quadrotors.

Read recorded flights, calibrate and evaluate models of a vehicle, find the effect that a model lacks, and take
wrenches and their derivatives as numpy arrays. A first look:

    import odmc
    flight = odmc.read_flight('flight.bag', 'my_quad.yaml')
    result = odmc.calibrate(flight, 'my_quad.yaml')
    print(result)
    print(result.parameters['thrust.k_f'])

SI units and radians throughout; a name carries its unit. Frames as in docs/model.md: W world (z up), B body (x
forward, y left, z up, origin Bo), S the odometry's sensor, I the IMU; p_WS is the position of S from Wo in W.
Quaternions are x, y, z, w. Bad input raises ValueError with one sentence that names what is wrong and where.

The ROS messages of the package are in odmc.msg; importing them loads nothing of the rest.
"""

import importlib
from typing import Any, List

_PLACES = {
    '_analysis': ('Calibration', 'ClosedLoop', 'Evaluation', 'calibrate', 'close_loop', 'estimator_options', 'evaluate',
                  'simulate'),
    '_flight': ('Flight', 'Inspection', 'Stream', 'read_flight'),
    '_model': ('BodyProperties', 'Effect', 'Model', 'ParameterSpec', 'State', 'Wrench', 'list_effects'),
    '_parameters': ('Parameter', 'Parameters', 'load_parameters'),
    '_tables': ('Table',),
    '_vehicle': ('Vehicle', 'load_vehicle'),
}
_MODULE_OF = {name: module for module, names in _PLACES.items() for name in names}

__all__ = sorted([*_MODULE_OF, '__version__'])


def __getattr__(name: str) -> Any:
    """Loads the library at the first use of one of its names."""
    if name == '__version__':
        value = importlib.import_module('odmc._native').version
    elif name in _MODULE_OF:
        value = getattr(importlib.import_module('odmc.' + _MODULE_OF[name]), name)
    else:
        raise AttributeError(f"module 'odmc' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> List[str]:
    return sorted({*globals(), *__all__})
