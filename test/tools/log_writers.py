"""Writes a flight in our CSV form as the logs an autopilot would have written: for tests of the readers.

World east, north, up becomes north, east, down; body forward, left, up becomes forward, right, down."""

import math
import struct
from typing import Dict, List, Sequence, Tuple

Row = Dict[str, float]
Quaternion = Tuple[float, float, float, float]  # w, x, y, z


def times(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product."""
    return (a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0])


def ned(row: Row, name: str) -> List[float]:
    """A vector of the world."""
    x, y, z = (row[name + axis] for axis in 'xyz')
    return [y, x, -z]


def frd(row: Row, name: str) -> List[float]:
    """A vector of the body."""
    x, y, z = (row[name + axis] for axis in 'xyz')
    return [x, -y, -z]


def attitude(row: Row) -> Quaternion:
    """Of FRD in NED: half turns about the line between north and east, and about the nose."""
    half = math.sqrt(0.5)
    q = tuple(row[name] for name in ('qw', 'qx', 'qy', 'qz'))
    return times(times((0.0, half, half, 0.0), q), (0.0, 1.0, 0.0, 0.0))


def stamp_us(row: Row) -> int:
    """Since the autopilot's start, 20 s before the flight."""
    return round(1e6 * row['t']) + 20000000


def rpm(row: Row, j: int) -> float:
    """Of rotor j, from 1."""
    return row[f'rotor{j}'] * 30.0 / math.pi


def write_ulog(rows: Sequence[Row], path: str) -> None:
    """A PX4 log: vehicle_odometry, sensor_combined, esc_status, battery_status."""
    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack('<Hc', len(body), kind) + body

    formats = ('vehicle_odometry:uint64_t timestamp;float[3] position;float[4] q;float[3] velocity;float[3] angular_velocity;'
               'uint8_t velocity_frame;', 'sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;',
               'esc_report:uint64_t timestamp;int32_t esc_rpm;',
               'esc_status:uint64_t timestamp;uint8_t esc_count;esc_report[8] esc;',
               'battery_status:uint64_t timestamp;float voltage_v;')
    with open(path, 'wb') as file:
        file.write(b'ULog\x01\x12\x35\x01' + struct.pack('<Q', 0) + message(b'B', bytes(40)))
        file.write(b''.join(message(b'F', text.encode()) for text in formats))
        for number, topic in enumerate(('vehicle_odometry', 'sensor_combined', 'esc_status', 'battery_status')):
            file.write(message(b'A', struct.pack('<BH', 0, number) + topic.encode()))
        for row in rows:
            now = stamp_us(row)
            file.write(message(b'D', struct.pack('<HQ13fB', 0, now, *ned(row, 'p'), *attitude(row), *ned(row, 'v'),
                                                 *frd(row, 'w'), 1)))
            file.write(message(b'D', struct.pack('<HQ6f', 1, now, *frd(row, 'g'), *frd(row, 'a'))))
            escs = b''.join(struct.pack('<Qi', now, round(rpm(row, j))) if j <= 4 else bytes(12) for j in range(1, 9))
            file.write(message(b'D', struct.pack('<HQB', 2, now, 4) + escs))
            file.write(message(b'D', struct.pack('<HQf', 3, now, row['vbat'])))


def write_dataflash(rows: Sequence[Row], path: str) -> None:
    """An ArduPilot log: XKF1, XKQ, IMU, ESC, BAT; it has no place for the columns w."""
    kinds = {1: ('XKF1', 'QBffffff', 'TimeUS,C,VN,VE,VD,PN,PE,PD'), 2: ('XKQ', 'QBffff', 'TimeUS,C,Q1,Q2,Q3,Q4'),
             3: ('IMU', 'QBffffff', 'TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ'), 4: ('ESC', 'QBf', 'TimeUS,Instance,RPM'),
             5: ('BAT', 'QBf', 'TimeUS,Inst,Volt'), 128: ('FMT', 'BBnNZ', 'Type,Length,Name,Format,Columns')}
    codes = {number: '<' + letters for number, (_, letters, _) in kinds.items()}
    codes[128] = '<BB4s16s64s'

    def message(number: int, *values: object) -> bytes:
        return b'\xa3\x95' + bytes([number]) + struct.pack(codes[number], *values)

    with open(path, 'wb') as file:
        for number in (128, 1, 2, 3, 4, 5):
            name, letters, labels = kinds[number]
            file.write(message(128, number, 3 + struct.calcsize(codes[number]), name.encode(), letters.encode(), labels.encode()))
        for row in rows:
            now = stamp_us(row)
            file.write(message(1, now, 0, *ned(row, 'v'), *ned(row, 'p')))
            file.write(message(2, now, 0, *attitude(row)))
            file.write(message(3, now, 0, *frd(row, 'g'), *frd(row, 'a')))
            for j in range(1, 5):
                file.write(message(4, now, j - 1, rpm(row, j)))
            file.write(message(5, now, 0, row['vbat']))
