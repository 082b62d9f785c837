from ._analysis import Calibration as Calibration
from ._analysis import ClosedLoop as ClosedLoop
from ._analysis import Evaluation as Evaluation
from ._analysis import calibrate as calibrate
from ._analysis import close_loop as close_loop
from ._analysis import estimator_options as estimator_options
from ._analysis import evaluate as evaluate
from ._analysis import simulate as simulate
from ._flight import Flight as Flight
from ._flight import Inspection as Inspection
from ._flight import Stream as Stream
from ._flight import read_flight as read_flight
from ._model import BodyProperties as BodyProperties
from ._model import Effect as Effect
from ._model import Model as Model
from ._model import ParameterSpec as ParameterSpec
from ._model import State as State
from ._model import Wrench as Wrench
from ._model import list_effects as list_effects
from ._parameters import Parameter as Parameter
from ._parameters import Parameters as Parameters
from ._parameters import load_parameters as load_parameters
from ._tables import Table as Table
from ._vehicle import Vehicle as Vehicle
from ._vehicle import load_vehicle as load_vehicle

__version__: str
