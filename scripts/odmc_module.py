"""The Python module odmc of this checkout's build (docs/python.md), for the scripts: from odmc_module import odmc."""

import os
import sys

ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
sys.path.insert(0, os.path.join(ROOT, 'build', 'devel', 'lib', 'python3', 'dist-packages'))

try:
    import odmc
    odmc.calibrate  # loads the library
except (ImportError, AttributeError) as error:
    sys.exit(f'the Python module is not built ({error}): ./scripts/setup && ./scripts/build -DODMC_PYTHON=ON')

__all__ = ['odmc']
