"""The unspoiled flights that faults are put into: recordings, flights of `simulate`, and a null
flight of another simulator."""

import copy
import json
import os
import subprocess
from typing import Any, Callable, Dict, List, Optional

import numpy as np
import yaml

from .airframe import Airframe
from .recording import FORCE, GYRO, Recording, read, read_csv
from .sensors import Sensors

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
VEHICLES = os.path.join(ROOT, 'config', 'vehicles')
IMU = {'frame': 'sensor', 'p_BS_m': [0.0, 0.0, 0.0], 'q_BS_xyzw': [0.0, 0.0, 0.0, 1.0],
       'estimate': False}

# Name: path in the data folder, vehicle file (in the data folder with a slash, else in
# config/vehicles), part [s] that is flight (the recordings' own throws, take-offs and landings are
# left to their own tests).
RECORDINGS = {
    'neurobem': ('neurobem/test1_first18s.csv', 'neurobem.yaml', 0.0, 99.0),
    'figure8': ('neurobem_fast/figure8_1.csv', 'neurobem_fast/vehicle.yaml', 0.0, 25.0),
    'brushless': ('imrc_cf21_brushless/eckart00.csv', 'imrc_cf21_brushless.yaml', 0.0, 99.0),
    'brushed': ('imrc_cf21_brushed/jana00.csv', 'imrc_cf21_brushed.yaml', 0.0, 99.0),
    'polyu': ('polyu_quad13/flight_2024-02-21_first70.csv', 'polyu_quad13.yaml', 18.5, 99.0),
    'indiflight': ('indiflight/LOG00267.csv', 'indiflight/vehicle.yaml', 4.0, 20.5),
    'nanodrone': ('nanodrone/random1_run1.csv', 'nanodrone/vehicle.yaml', 10.0, 34.0),
}
# Name: vehicle file, trajectory, duration [s], seed, whether it has an IMU.
SIMULATED = {
    'sim_octo': ('generic.yaml', 'octo', 25, 11, True),
    'sim_aggressive': ('generic.yaml', 'aggressive', 25, 12, False),
    'sim_circle': ('imrc_cf21_brushless.yaml', 'circle', 20, 13, True),
}
INDEPENDENT = {'independent': ('flight_041', 'vehicle_B.yaml', 0.0, 25.0)}


class Base:
    """One unspoiled flight with its vehicle (as read from YAML), airframe and sensors."""

    def __init__(self, name: str, rec: Recording, vehicle: Dict[str, Any],
                 truth: Optional[Callable[[Airframe], None]] = None) -> None:
        self.name, self.rec, self.vehicle = name, rec, vehicle
        self.frame = Airframe(vehicle)
        self.frame.fit(rec)
        if truth is not None:
            truth(self.frame)
        self.sensors = Sensors(rec, self.frame)
        p, _ = self.frame.body_poses(rec)
        self.floor = min(0.0, float(p[:, 2].min()) - 0.3)

    def vehicle_copy(self) -> Dict[str, Any]:
        """A vehicle to be spoiled."""
        return copy.deepcopy(self.vehicle)


def data_folder() -> str:
    """$ODMC_DATA_DIR, else ../shared/data beside the checkout."""
    return os.environ.get('ODMC_DATA_DIR') or os.path.join(ROOT, '..', 'shared', 'data')


def load_yaml(path: str) -> Dict[str, Any]:
    """A YAML file."""
    with open(path, encoding='utf-8') as file:
        return yaml.safe_load(file)


def recorded(name: str) -> Base:
    """A recording, starting at 0."""
    path, vehicle, start, end = RECORDINGS[name]
    rec = read(os.path.join(data_folder(), path), start, end)
    folder = data_folder() if '/' in vehicle else VEHICLES
    return Base(name, rec.shifted(-float(rec.t[0])), load_yaml(os.path.join(folder, vehicle)))


def simulated(name: str, simulate: List[str], folder: str) -> Base:
    """A flight of `simulate`. Where it has an IMU, its columns come from the true states, with an
    offset and noise of a cheap one."""
    file, trajectory, duration, seed, imu = SIMULATED[name]
    path = os.path.join(folder, name + '.csv')
    subprocess.run(simulate + ['--vehicle', os.path.join(VEHICLES, file), '--trajectory',
                               trajectory, '--duration', str(duration), '--seed', str(seed),
                               '--log-rate', '200', '--out', path], check=True,
                   capture_output=True)
    rec, vehicle = read(path, 0.0, 1e9), load_yaml(os.path.join(VEHICLES, file))
    truth = read_csv(path[:-4] + '_truth.csv')
    if imu:
        add_imu(rec, truth, float(vehicle['mass_kg']), np.random.default_rng(seed))
        vehicle['imu'] = copy.deepcopy(IMU)
    known = load_yaml(path[:-4] + '_truth.yaml')['parameters']
    return Base(name, rec, vehicle, lambda frame: set_coefficients(
        frame, known['thrust.k_f']['value'], [known[f'drag.d_{x}']['value'] for x in 'xyz'],
        known['hvt.k_h']['value'], [known[f'inertia.{x}']['value'] for x in 'xyz']))


def add_imu(rec: Recording, truth: Dict[str, np.ndarray], mass: float,
            rng: np.random.Generator) -> None:
    """Gyro and accelerometer at the body's origin from true rates and forces."""
    def column(names: List[str]) -> np.ndarray:
        return np.stack([np.interp(rec.t, truth['t'], truth[n]) for n in names], axis=-1)
    n = len(rec.t)
    gyro = column(['wx', 'wy', 'wz']) + [0.01, -0.006, 0.004] + 0.01 * rng.standard_normal((n, 3))
    force = column(['f_x', 'f_y', 'f_z']) / mass + [0.05, -0.04, 0.06]
    rec.put(GYRO, gyro)
    rec.put(FORCE, force + 0.25 * rng.standard_normal((n, 3)))


def set_coefficients(frame: Airframe, k_f: float, drag: List[float], k_h: float,
                     inertia: List[float]) -> None:
    """Known coefficients in place of fitted ones."""
    frame.k_f, frame.drag, frame.k_h = k_f, np.array(drag, float), k_h
    frame.inertia = np.array(inertia, float)
    frame.rotors_late_s = frame.odometry_late_s = 0.0


def independent(name: str) -> Base:
    """A flight of the independent simulator in which nothing undeclared acts."""
    flight, vehicle_file, start, end = INDEPENDENT[name]
    folder = os.path.join(data_folder(), 'independent_simulator')
    rec = read(os.path.join(folder, 'input', flight + '.csv.gz'), start, end)
    source = load_yaml(os.path.join(folder, 'input', vehicle_file))
    with open(os.path.join(folder, 'truth.json'), encoding='utf-8') as file:
        entry = next(f for f in json.load(file)['flights'] if f['flight'] == flight)
    known = entry['declared']
    vehicle = independent_vehicle(source, known)
    return Base(name, rec.shifted(-float(rec.t[0])), vehicle, lambda frame: set_coefficients(
        frame, float(source['kf']), [-d for d in known['d']], known['kh'], entry['inertia']))


def independent_vehicle(source: Dict[str, Any], known: Dict[str, Any]) -> Dict[str, Any]:
    """Its vehicle as a vehicle file of ours, the IMU where it says it is."""
    rotors = [{'position_m': [float(x) for x in r['position']],
               'spin': 'cw' if r['yaw_torque_sign'] > 0 else 'ccw',
               'radius_m': source['rotor_radius']} for r in source['rotors']]
    half = 0.5 * np.array(known['imu_rot'])
    imu = dict(IMU, p_BS_m=known['imu_pos'], q_BS_xyzw=[*map(float, half), 1.0])
    k_f, k_m = float(source['kf']), float(source['km'])
    return {'name': source['name'], 'mass_kg': source['mass'], 'gravity_m_s2': source['gravity'],
            'inertia_kg_m2': source['inertia'], 'rotors': rotors, 'odometry': {'frame': 'body'},
            'imu': imu,
            'parameters': {
                'thrust.k_f': {'value': k_f, 'sigma': 0.3 * k_f, 'state': 'estimated'},
                'rotor_torque.k_m': {'value': k_m, 'sigma': 0.3 * k_m, 'state': 'frozen'}}}


def names() -> List[str]:
    """All base flights."""
    return [*RECORDINGS, *SIMULATED, *INDEPENDENT]


def load(name: str, simulate: List[str], folder: str) -> Base:
    """A base flight by name; simulated ones are made in a folder."""
    if name in RECORDINGS:
        return recorded(name)
    if name in SIMULATED:
        return simulated(name, simulate, folder)
    return independent(name)
