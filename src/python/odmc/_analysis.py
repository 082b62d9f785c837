"""Calibration, evaluation, closing the loop, simulation."""

import functools
import json
import os
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from . import _native
from ._flight import Flight, read_flight
from ._parameters import Parameters, ParametersLike, as_parameters
from ._tables import Table
from ._vehicle import Vehicle, VehicleLike, as_vehicle

FlightLike = Union[Flight, str, 'os.PathLike[str]']
Progress = Optional[Callable[[float], None]]
Option = Union[float, int, bool, str]
_Axes = Optional[np.ndarray]


class _Result:
    """What a function found; `report` is the tool's report.json as a dictionary."""

    def __init__(self, found: _native.Found) -> None:
        self._found = found
        self.report: Dict[str, Any] = json.loads(found.report)
        self.parameters = Parameters(found.parameters)

    @property
    def trust(self) -> str:
        """'good', 'doubtful' or 'bad': how far to rely on the result; report['trust_reasons'] says why."""
        return self.report['trust']

    @property
    def warnings(self) -> List[str]:
        """One sentence each."""
        return self.report['warnings']

    def __str__(self) -> str:
        return self._found.table

    def __repr__(self) -> str:
        return f'<odmc.{type(self).__name__} of {len(self.parameters)} parameters, trust: {self.trust}>'


def _axes(values: Optional[Sequence[Optional[float]]]) -> _Axes:
    return None if values is None else np.array([np.nan if v is None else v for v in values])


class Evaluation(_Result):
    """A flight predicted with fixed parameters. str() is the table that evaluate prints."""

    @functools.cached_property
    def prediction(self) -> Table:
        """Each sample in the body axes of the vehicle file: t_s, speed_m_s, measured_force_x_N.., predicted_force_x_N..,
        EFFECT_force_x_N.., the same of torque [N m] about Bcm and angular_acceleration [rad/s^2] where the flight shows it."""
        return Table(self._found.samples)

    @property
    def force_rmse_N(self) -> _Axes:
        """Root mean square of measured minus predicted force (3,); None where it cannot be had."""
        return _axes(self.report['prediction']['force_rmse_N'])

    @property
    def torque_rmse_Nm(self) -> _Axes:
        """The same of the torque about Bcm."""
        return _axes(self.report['prediction']['torque_rmse_Nm'])


class Calibration(Evaluation):
    """A calibrated flight. str() is the table that calibrate prints."""

    @functools.cached_property
    def history(self) -> Table:
        """The estimate after each update: t_s, NAME and NAME_sigma of every parameter."""
        return Table(self._found.history)


class ClosedLoop(_Result):
    """What a declared model lacks on a flight. str() is the table that close_loop prints."""

    @property
    def verdict(self) -> str:
        """'effect', 'none' or 'unexplained'."""
        return self.report['verdict']

    @property
    def effects(self) -> List[Dict[str, Any]]:
        """The effects that earned their place, each with name, score [nats], p_value, alternatives, parameters."""
        return self.report['effects']

    @property
    def model(self) -> List[str]:
        """Names of the extended model's effects."""
        return self.report['model']

    @functools.cached_property
    def residuals(self) -> Table:
        """Measured minus predicted, before and after: t_s, held_out (0 or 1), speed_m_s, before_force_x_N..,
        before_torque_x_Nm.., after_..."""
        return Table(self._found.samples)

    @property
    def force_rmse_N(self) -> Tuple[_Axes, _Axes]:
        """Before and after, on the blocks held out (3,); None where it cannot be had."""
        return _axes(self.report['force_rmse_before']), _axes(self.report['force_rmse_after'])

    @property
    def torque_rmse_Nm(self) -> Tuple[_Axes, _Axes]:
        """The same of the torque about Bcm."""
        return _axes(self.report['torque_rmse_before']), _axes(self.report['torque_rmse_after'])


def estimator_options() -> Dict[str, Option]:
    """Every option of the estimator with its default, as config/estimator.yaml explains them."""
    options: Dict[str, Option] = {}
    for line in _native.estimator_options().splitlines():
        key, text = line.split(': ', 1)
        options[key] = json.loads(text)
    return options


def _settings(config: Union[str, 'os.PathLike[str]'], keyframe_rate_hz: Optional[float], window_s: Optional[float],
              threads: Optional[int], options: Optional[Mapping[str, Option]]) -> _native.EstimatorSettings:
    for name, value in (('keyframe_rate_hz', keyframe_rate_hz), ('window_s', window_s), ('threads', threads)):
        if value is not None and not value > 0:
            raise ValueError(f'{name} is {value}; expected a number above zero')
    texts = [f'{key}={str(value).lower() if isinstance(value, bool) else value}' for key, value in (options or {}).items()]
    return _native.EstimatorSettings(os.fspath(config), keyframe_rate_hz or 0.0, window_s or 0.0, threads or 0, texts)


def _flight(flight: FlightLike, vehicle: Vehicle) -> Flight:
    return flight if isinstance(flight, Flight) else read_flight(flight, vehicle)


def _chosen(vehicle: VehicleLike, effects: Sequence[str], without: Sequence[str], free: Sequence[str],
            freeze: Sequence[str], parameters: Optional[ParametersLike]) -> Vehicle:
    """The vehicle with the model that the arguments choose; one that was chosen already stays where they say nothing."""
    known = as_vehicle(vehicle)
    if known.native is not known.native_file and not (effects or without or free or freeze or parameters is not None):
        return known
    return known.choose(effects=effects, without=without, free=free, freeze=freeze, parameters=parameters)


def calibrate(flight: FlightLike, vehicle: VehicleLike, *, effects: Sequence[str] = (), without: Sequence[str] = (),
              free: Sequence[str] = (), freeze: Sequence[str] = (), parameters: Optional[ParametersLike] = None,
              config: Union[str, 'os.PathLike[str]'] = '', keyframe_rate_hz: Optional[float] = None,
              window_s: Optional[float] = None, threads: Optional[int] = None,
              options: Optional[Mapping[str, Option]] = None, leave_out_s: Optional[float] = None,
              position_noise_m: float = 0.0, seed: int = 1, force: bool = False, progress: Progress = None) -> Calibration:
    """Calibrates a vehicle's model on a flight with the online estimator, then predicts the flight with the result.

    flight: an odmc.Flight, or a file that read_flight() reads with its defaults. vehicle: an odmc.Vehicle or a file.
    effects, without, free, freeze, parameters: the model, as Vehicle.choose().
    config (YAML), keyframe_rate_hz, window_s, threads, options {key: value}: the estimator; see estimator_options().
    leave_out_s: also leaves out every block of this many seconds in turn and predicts it with what the rest shows.
    position_noise_m, seed: white noise added to what the estimator sees.
    force: goes on where the recording is wrong beyond learning. progress: called with the share done, 0 to 1.

    Gives the same figures as the tool `calibrate`. Releases the GIL; Ctrl-C ends it. Raises ValueError with a sentence.
    """
    if leave_out_s is not None and not leave_out_s > 0.0:
        raise ValueError(f'leave_out_s is {leave_out_s}; expected a time above zero')
    if not position_noise_m >= 0.0:
        raise ValueError(f'position_noise_m is {position_noise_m}; expected a length of zero or more')
    quad = _chosen(vehicle, effects, without, free, freeze, parameters)
    settings = _settings(config, keyframe_rate_hz, window_s, threads, options)
    return Calibration(_native.calibrate(
        _flight(flight, quad).native, quad.native_file, quad.native, None if quad.start is None else quad.start.native,
        settings, leave_out_s or 0.0, position_noise_m, seed, force, progress))


def evaluate(flight: FlightLike, vehicle: VehicleLike, parameters: ParametersLike, *, follow: Sequence[str] = (),
             k_f_walk_rate: float = 0.0, force: bool = False) -> Evaluation:
    """Predicts force and torque on a flight with given parameters. As the tool `evaluate`.

    parameters: an odmc.Parameters or a parameters.yaml; they bring the model's effects.
    follow: names of parameters that are learned on this flight, each sample from what was before it.
    k_f_walk_rate: above 0 k_f, and k_m where it was estimated, follow too, as a random walk of this relative change
        [1/sqrt(s)].
    """
    if not k_f_walk_rate >= 0.0:
        raise ValueError(f'k_f_walk_rate is {k_f_walk_rate}; expected a number of zero or more')
    quad, given = as_vehicle(vehicle), as_parameters(parameters)
    return Evaluation(_native.evaluate(_flight(flight, quad).native, quad.native_file, given.native, k_f_walk_rate,
                                       list(follow), force))


def close_loop(flight: FlightLike, vehicle: VehicleLike, *, effects: Sequence[str] = (), without: Sequence[str] = (),
               free: Sequence[str] = (), freeze: Sequence[str] = (), parameters: Optional[ParametersLike] = None,
               config: Union[str, 'os.PathLike[str]'] = '', keyframe_rate_hz: Optional[float] = None,
               window_s: Optional[float] = None, threads: Optional[int] = None,
               options: Optional[Mapping[str, Option]] = None, block_s: Optional[float] = None,
               most_effects: Optional[int] = None, rule_out: Sequence[str] = (),
               decision: Optional[Mapping[str, float]] = None, force: bool = False,
               progress: Progress = None) -> ClosedLoop:
    """Finds the effect that a model lacks on a flight, adds it, and says what it changed on blocks held out.

    As the tool `close_loop` on one flight (docs/closing_the_loop.md). With parameters a thrust coefficient known to 5 %
    is held, so that a change of mass shows. block_s: length of a block of time. most_effects: adds at most so many.
    rule_out: effects that cannot act, as wind and gust indoors. decision: numbers of the decision by name, as the tool's
    --decision. All else as calibrate().
    """
    if block_s is not None and not block_s > 0.0:
        raise ValueError(f'block_s is {block_s}; expected a time above zero')
    if most_effects is not None and not most_effects >= 0:
        raise ValueError(f'most_effects is {most_effects}; expected a number of zero or more')
    quad = _chosen(vehicle, effects, without, free, freeze, parameters)
    settings = _settings(config, keyframe_rate_hz, window_s, threads, options)
    return ClosedLoop(_native.close_loop(
        _flight(flight, quad).native, quad.native_file, quad.native, None if quad.start is None else quad.start.native,
        settings, block_s or 0.0, most_effects, list(rule_out),
        [f'{name}={value}' for name, value in (decision or {}).items()], force, progress))


def simulate(vehicle: VehicleLike, *, trajectory: str = 'octo', duration_s: float = 30.0, seed: int = 1,
             noise: Union[str, 'os.PathLike[str]'] = 'default', ground_s: float = 0.0,
             log_rate_hz: float = 400.0) -> Tuple[Flight, Parameters]:
    """Flies the vehicle's model in simulation. Returns the flight as its sensors recorded it, and the true parameters.

    trajectory: a name as of the tool `simulate`, or a waypoint file. noise: 'none', 'default' or a YAML file.
    ground_s: time on the ground before take-off. The same arguments give the same flight.
    """
    log, truth = _native.simulate(as_vehicle(vehicle).native, os.fspath(trajectory), duration_s, seed, os.fspath(noise), ground_s,
                                  log_rate_hz)
    return Flight(log), Parameters(truth)
