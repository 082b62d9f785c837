#!/usr/bin/python3
"""Makes the small samples of the data sets' own formats in this folder.

All numbers are invented: a vehicle on a smooth path with a smooth attitude, by formula. Nothing is
taken from any recording. Run it without arguments to write the files again; the tests import it to
make bags and broken variants.
"""

import csv
import math
import os
import struct
from typing import Dict, List, Sequence, Tuple

HERE = os.path.dirname(os.path.realpath(__file__))

START_S = 1_500_000_000  # of the Blackbird samples, since 1970
GRAVITY = 9.81


# ---- Rotations and messages --------------------------------------------------------------------


def multiply(a: Sequence[float], b: Sequence[float]) -> Tuple[float, float, float, float]:
    """Hamilton product, w first."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw)


def to_body(q_WB: Sequence[float], v_W: Sequence[float]) -> List[float]:
    """R_WB^T v_W."""
    turned = multiply(multiply(conjugate(q_WB), (0.0, *v_W)), q_WB)
    return list(turned[1:])


def set_xyz(target, values: Sequence[float]) -> None:
    """Sets x, y, z of a message."""
    target.x, target.y, target.z = values[0], values[1], values[2]


def get_xyz(source) -> List[float]:
    """x, y, z of a message."""
    return [source.x, source.y, source.z]


def get_quaternion(source) -> List[float]:
    """w, x, y, z of a message."""
    return [source.w, source.x, source.y, source.z]


# ---- The flight, z up and FLU ------------------------------------------------------------------


def position(t: float) -> List[float]:
    """p_WB [m]."""
    return [0.8 * math.sin(2.0 * t), 0.6 * math.sin(1.5 * t + 0.4), 1.0 + 0.2 * math.sin(1.1 * t)]


def velocity(t: float) -> List[float]:
    """v_WB [m/s]."""
    return [1.6 * math.cos(2.0 * t), 0.9 * math.cos(1.5 * t + 0.4), 0.22 * math.cos(1.1 * t)]


def acceleration(t: float) -> List[float]:
    """a_WB [m/s^2]."""
    return [-3.2 * math.sin(2.0 * t), -1.35 * math.sin(1.5 * t + 0.4),
            -0.242 * math.sin(1.1 * t)]


def attitude(t: float) -> Tuple[float, ...]:
    """q_WB, w first: yaw, then pitch, then roll."""
    angles = (0.8 * math.sin(1.2 * t), 0.2 * math.sin(2.3 * t + 1.0), 0.25 * math.sin(3.0 * t))
    q: Tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    for angle, axis in zip(angles, (3, 2, 1)):
        turn = [math.cos(angle / 2), 0.0, 0.0, 0.0]
        turn[axis] = math.sin(angle / 2)
        q = multiply(q, turn)
    return q


def conjugate(q: Sequence[float]) -> List[float]:
    """The inverse of a unit quaternion."""
    return [q[0], -q[1], -q[2], -q[3]]


def body_rates(t: float) -> List[float]:
    """w_WB_B [rad/s], by a central difference of the attitude."""
    h = 1e-5
    step = multiply(conjugate(attitude(t - h)), attitude(t + h))
    return [value / h for value in step[1:]]


def specific_force(t: float) -> List[float]:
    """Accelerometer along B [m/s^2]."""
    a = acceleration(t)
    return to_body(attitude(t), [a[0], a[1], a[2] + GRAVITY])


def rotor_speed(t: float, rotor: int) -> float:
    """[rad/s], linear in time so that interpolation is exact."""
    return 900.0 + 10.0 * rotor + (20.0 + 5.0 * rotor) * t


# ---- The data README's form --------------------------------------------------------------------


def flight_rows(count: int, rate_hz: float) -> List[Dict[str, object]]:
    """Rows in the form of the data README."""
    return [flight_row(i / rate_hz) for i in range(count)]


def flight_row(t: float) -> Dict[str, object]:
    """One row."""
    row: Dict[str, object] = {'t': f'{t:.6f}'}
    groups = (('p', 'xyz', position(t)), ('q', 'wxyz', attitude(t)), ('v', 'xyz', velocity(t)),
              ('w', 'xyz', body_rates(t)), ('a', 'xyz', specific_force(t)))
    for letter, axes, values in groups:
        row.update({letter + axis: f'{value:.9g}' for axis, value in zip(axes, values)})
    row.update({f'rotor{i}': f'{rotor_speed(t, i):.7g}' for i in range(1, 5)})
    row['vbat'] = f'{16.0 - 0.1 * t:.3f}'
    row.update({f'pwm{i}': 30000 + 100 * i + int(50 * t) for i in range(1, 5)})
    return row


def write_rows(path: str, rows: Sequence[Dict[str, object]]) -> None:
    """Writes rows under their names."""
    with open(path, 'w', encoding='utf-8', newline='') as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator='\n')
        writer.writeheader()
        writer.writerows(rows)


# ---- NeuroBEM ----------------------------------------------------------------------------------


def neurobem_rows(count: int = 40, rate_hz: float = 40.0) -> List[Dict[str, object]]:
    """Rows of the NeuroBEM data set's own CSV."""
    return [neurobem_row(i / rate_hz) for i in range(count)]


def neurobem_row(t: float) -> Dict[str, object]:
    """One row; angular acceleration and dmot, which are not read, are zero."""
    q = attitude(t)
    row: Dict[str, object] = {'t': f'{t:.4f}'}
    groups = (('ang acc', 'xyz', (0, 0, 0)), ('ang vel', 'xyz', body_rates(t)),
              ('quat', 'xyzw', (q[1], q[2], q[3], q[0])), ('acc', 'xyz', specific_force(t)),
              ('vel', 'xyz', to_body(q, velocity(t))), ('pos', 'xyz', position(t)))
    for name, axes, values in groups:
        row.update({f'{name} {axis}': f'{value:.6g}' for axis, value in zip(axes, values)})
    row.update({f'mot {i}': f'{rotor_speed(t, i):.6g}' for i in range(1, 5)})
    row.update({f'dmot {i}': 0 for i in range(1, 5)})
    row['vbat'] = f'{16.0 - 0.1 * t:.3f}'
    return row


# ---- Blackbird ---------------------------------------------------------------------------------

MOTOR_RPM = 'Header header\ntime[] sample_stamp\nfloat32[] rpm\n'
MOTOR_PWM = 'Header header\nuint16[] pwm\n'
COVARIANCE = [0.0001, 0.0, 0.0, 0.0, 0.0001, 0.0, 0.0, 0.0, 0.0001]


def blackbird_class(name: str, text: str) -> type:
    """A message class of the data set, made from its definition."""
    import genpy.dynamic
    from std_msgs.msg import Header
    full = f'{text}{"=" * 80}\nMSG: std_msgs/Header\n{Header._full_text}'
    return genpy.dynamic.generate_dynamic(f'blackbird/{name}', full)[f'blackbird/{name}']


def ned_pose(t: float) -> Tuple[List[float], Tuple[float, ...]]:
    """Position and attitude in NED and FRD."""
    half = math.sqrt(0.5)
    p = position(t)
    q = multiply(multiply((0.0, half, half, 0.0), attitude(t)), (0.0, 1.0, 0.0, 0.0))
    return [p[1], p[0], -p[2]], q


def to_imu(v_B: Sequence[float]) -> List[float]:
    """FLU to the IMU's axes: to FRD, then back by the 90 deg of yaw."""
    x, y, z = v_B[0], -v_B[1], -v_B[2]
    return [y, -x, z]


def ros_time(t: float):
    """Stamp of the flight's time t, on whole microseconds as the data set has them."""
    import genpy
    return genpy.Time(*divmod(START_S * 10**9 + round(t * 1e6) * 1000, 10**9))


def blackbird_messages(seconds: float = 1.0) -> Dict[str, List]:
    """Messages of each topic of a bag of the data set."""
    rpm_class, pwm_class = blackbird_class('MotorRPM', MOTOR_RPM), blackbird_class('MotorPWM',
                                                                                  MOTOR_PWM)

    def times(rate_hz: float) -> List[float]:
        return [i / rate_hz for i in range(int(seconds * rate_hz))]

    return {'/blackbird/state': [state_message(t) for t in times(40.0)],
            '/blackbird/imu': [imu_message(t) for t in times(40.0)],
            '/blackbird/rotor_rpm': [rpm_message(rpm_class, t) for t in times(30.0)],
            '/blackbird/pwm': [pwm_message(pwm_class, t) for t in times(20.0)]}


def stamped(message, t: float, frame: str):
    """The message with its header filled."""
    message.header.stamp = ros_time(t)
    message.header.frame_id = frame
    return message


def state_message(t: float):
    """geometry_msgs/PoseStamped."""
    from geometry_msgs.msg import PoseStamped
    message = stamped(PoseStamped(), t, 'mocap')
    p, q = ned_pose(t)
    set_xyz(message.pose.position, [round(value, 6) for value in p])
    message.pose.orientation.w = round(q[0], 6)
    set_xyz(message.pose.orientation, [round(value, 6) for value in q[1:]])
    return message


def imu_message(t: float):
    """sensor_msgs/Imu in the IMU's axes."""
    from sensor_msgs.msg import Imu
    message = stamped(Imu(), t, 'imu')
    set_xyz(message.angular_velocity, [round(v, 5) for v in to_imu(body_rates(t))])
    set_xyz(message.linear_acceleration, [round(v, 5) for v in to_imu(specific_force(t))])
    message.angular_velocity_covariance = COVARIANCE
    message.linear_acceleration_covariance = COVARIANCE
    return message


def float32(value: float) -> float:
    """The value as a bag keeps it."""
    return struct.unpack('f', struct.pack('f', value))[0]


def rpm_message(message_class: type, t: float):
    """blackbird/MotorRPM: rotor k was sampled k ms before the header's stamp."""
    message = stamped(message_class(), t, '0')
    times = [t - 0.001 * i for i in range(1, 5)]
    message.sample_stamp = [ros_time(time) for time in times]
    message.rpm = [float32(rotor_speed(time, i) * 30.0 / math.pi)
                   for i, time in enumerate(times, 1)]
    return message


def pwm_message(message_class: type, t: float):
    """blackbird/MotorPWM."""
    message = stamped(message_class(), t, '0')
    message.pwm = [1200 + 10 * i for i in range(1, 5)]
    return message


def write_blackbird_bag(path: str, messages: Dict[str, List]) -> None:
    """A bag as the data set has them."""
    import rosbag
    with rosbag.Bag(path, 'w') as bag:
        for topic, entries in messages.items():
            for message in entries:
                bag.write(topic, message, message.header.stamp)


def export_cells(message) -> Tuple[List[str], List[str]]:
    """Header and row of the data set's CSV exports: one column per line of the printed message.

    Lines without a colon, the '-' before each entry of a list of stamps, are in the header but have
    no value, which is why the exports' headers are wider than their rows.
    """
    names, values = ['rosbagTimestamp'], [str(message.header.stamp)]
    for line in str(message).split('\n'):
        name, colon, value = line.partition(':')
        names.append(name.strip())
        if colon:
            values.append(value.strip())
    return names, values


def write_blackbird_exports(folder: str, messages: Dict[str, List]) -> None:
    """The CSV exports."""
    os.makedirs(folder, exist_ok=True)
    for topic, entries in messages.items():
        path = os.path.join(folder, topic[1:].replace('/', '_slash_') + '.csv')
        with open(path, 'w', encoding='utf-8', newline='') as file:
            writer = csv.writer(file, lineterminator='\n')
            writer.writerow(export_cells(entries[0])[0])
            writer.writerows(export_cells(message)[1] for message in entries)


def write_ground_truth(path: str, messages: Dict[str, List]) -> None:
    """groundTruthPoses.csv: no header, microseconds, p, q with w first."""
    with open(path, 'w', encoding='utf-8', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        for m in messages['/blackbird/state']:
            writer.writerow([m.header.stamp.to_nsec() // 1000, *get_xyz(m.pose.position),
                             *get_quaternion(m.pose.orientation)])


def main() -> None:
    """Writes the samples."""
    write_rows(os.path.join(HERE, 'neurobem_sample.csv'), neurobem_rows())
    write_rows(os.path.join(HERE, 'flight_sample.csv'), flight_rows(40, 40.0))
    messages = blackbird_messages()
    write_blackbird_exports(os.path.join(HERE, 'blackbird', 'csv'), messages)
    write_ground_truth(os.path.join(HERE, 'blackbird', 'groundTruthPoses.csv'), messages)


if __name__ == '__main__':
    main()
