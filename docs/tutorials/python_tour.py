#!/usr/bin/python3
"""The Python module by example: from a flight to a better model, in cells (# %%) that editors run one by one.

  python_tour.py [DIR]     draws its pictures into DIR (default: the current folder)

docs/python.md shows what it prints and draws."""

# %% Set up: the module is where a sourced workspace or the Debian package puts it
import os
import sys

import matplotlib
matplotlib.use('Agg')
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

import odmc  # noqa: E402

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
OUT = sys.argv[1] if len(sys.argv) > 1 else '.'
AXES = 'xyz'

# %% A vehicle and two flights. read_flight('flight.bag', quad) reads a recorded one.
quad = odmc.load_vehicle(os.path.join(ROOT, 'config', 'vehicles', 'generic.yaml'))
flight, truth = odmc.simulate(quad, trajectory='octo', duration_s=20.0, seed=1)
unseen, _ = odmc.simulate(quad, trajectory='aggressive', duration_s=15.0, seed=2)
print(quad)
print(flight)
speed = np.linalg.norm(flight.odometry.v_WS, axis=1)
print(f'fastest: {speed.max():.1f} m/s; rotors turn at {flight.rotors.speed_rad_s.mean():.0f} rad/s on average')

# %% Calibrate a model that knows no drag
declared = odmc.calibrate(flight, quad, without=['drag', 'hvt'])
for name in ('thrust.k_f', 'centre_of_gravity.x', 'inertia.x'):
    print(declared.parameters[name])
print('force error [N]:', np.round(declared.force_rmse_N, 3), ' trust:', declared.trust)

# %% How the estimate became sure of itself
history = declared.history
figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), layout='constrained')
for panel, name, scale, unit in zip(axes, ('thrust.k_f', 'centre_of_gravity.x'), (1e6, 1e3), ('1e-6 N s²', 'mm')):
    value, sigma = scale * history[name], scale * history[name + '_sigma']
    panel.fill_between(history['t_s'], value - 3 * sigma, value + 3 * sigma, alpha=0.3, label='3 sigma')
    panel.plot(history['t_s'], value, label='estimate')
    panel.axhline(scale * truth[name].value, color='k', linewidth=1, label='truth')
    half = 6 * sigma[len(sigma) // 4]
    panel.set(xlabel='t [s]', ylabel=f'{name} [{unit}]', ylim=(value[-1] - half, value[-1] + half))
axes[0].legend()
figure.savefig(os.path.join(OUT, 'python_history.png'), dpi=90)

# %% What does it leave unexplained? The error along x follows the velocity along x: drag.
prediction = declared.prediction
error = prediction.vectors('measured_force_', '_N') - prediction.vectors('predicted_force_', '_N')
u, w = flight.odometry.q_WS[:, :3], flight.odometry.q_WS[:, 3:]
v_W = flight.odometry.v_WS
v_B = v_W - 2.0 * np.cross(u, w * v_W - np.cross(u, v_W))  # turned from the world into the body
v_x = np.interp(prediction['t_s'], flight.odometry.t_s, v_B[:, 0])
print(f'error along x = {np.polyfit(v_x, error[:, 0], 1)[0]:.2f} N s/m times velocity,'
      f' correlation {np.corrcoef(v_x, error[:, 0])[0, 1]:.2f}')

# %% close_loop() finds the effect by itself; its errors are on blocks of the flight that the fit has not used
loop = odmc.close_loop(flight, quad, without=['drag', 'hvt'])
print('verdict:', loop.verdict)
for effect in loop.effects:
    print(f'  {effect["name"]}: {effect["score"]:.0f} nats')
before, after = loop.force_rmse_N
print('force error held out [N]:', np.round(before, 3), '->', np.round(after, 3))

residuals = loop.residuals
figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), layout='constrained', sharey=True)
for panel, axis in zip(axes, 'xy'):
    for when, colour in (('before', 'C1'), ('after', 'C0')):
        panel.plot(residuals['speed_m_s'], residuals[f'{when}_force_{axis}_N'], '.', markersize=2, color=colour, label=when)
    panel.set(xlabel='speed [m/s]', title=f'force along {axis} left over [N]')
axes[0].legend(markerscale=5)
figure.savefig(os.path.join(OUT, 'python_residual.png'), dpi=90)

# %% Compare both models on a flight that neither has seen
for name, parameters in (('declared', declared.parameters), ('extended', loop.parameters)):
    rated = odmc.evaluate(unseen, quad, parameters)
    print(f'{name:9s} force error on the unseen flight [N]:', np.round(rated.force_rmse_N, 3))

# %% Models as functions: forces against airspeed and their derivatives, as numpy arrays
model = odmc.Model(quad.choose(parameters=loop.parameters))
v = np.linspace(-12.0, 12.0, 49)
state = odmc.State(rotor_speed_rad_s=np.full(4, 1100.0), v_AB_B=np.column_stack([v, 0 * v, 0 * v]))
wrench = model.wrench(state, loop.parameters, derivatives=True)
print('shapes:', wrench.f_B.shape, wrench.d_state.shape, wrench.d_values.shape)
print(f'd f_x / d v_x at rest: {wrench.d_state[24, 0, 0]:.3f} N s/m')
figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), layout='constrained')
for panel, axis in zip(axes, (0, 2)):
    panel.plot(v, wrench.f_B[:, axis], label='all effects')
    for name, part in model.effect_wrenches(state, loop.parameters).items():
        if np.abs(part.f_B[:, axis]).max() > 1e-6:
            panel.plot(v, part.f_B[:, axis], '--', label=name)
    panel.set(xlabel='airspeed along x [m/s]', ylabel=f'force along {AXES[axis]} [N]')
    panel.legend()
figure.savefig(os.path.join(OUT, 'python_forces.png'), dpi=90)

# %% Tables for pandas, files for the tools
loop.parameters.save(os.path.join(OUT, 'parameters.yaml'))
try:
    print(loop.parameters.to_pandas()[['value', 'sigma', 'unit']].head(3))
except ImportError:
    print('pandas is not installed')
