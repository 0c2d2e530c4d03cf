"""The rigid bodies of the vehicle as MuJoCo sees them: a free chassis and four wheels that slide up and down on it.

MuJoCo integrates the bodies; every force on them is ours (`offpiste.simulation.forces`), so contacts and constraints
are off. Wheels do not spin here: their spin is a state of its own, and its reaction acts as a torque.
"""

from typing import Any

from offpiste.conventions import GRAVITY
from offpiste.simulation.parameters import VehicleParameters

CHASSIS, FIRST_WHEEL = 1, 2
"""Body numbers in MuJoCo; wheels follow in the order of `WHEELS`."""

_MODEL = """
<mujoco model="side-by-side">
  <option timestep="{timestep}" gravity="0 0 -{gravity}" integrator="Euler">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body name="chassis">
      <freejoint/>
      <inertial pos="{com[0]} {com[1]} {com[2]}" mass="{mass}" diaginertia="{roll} {pitch} {yaw}"/>
      {wheels}
    </body>
  </worldbody>
</mujoco>
"""

_WHEEL = """
      <body name="wheel-{number}" pos="{x} {y} 0">
        <joint type="slide" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="{mass}" diaginertia="{tilt} {spin} {tilt}"/>
      </body>"""


def build_bodies(parameters: VehicleParameters, timestep: float) -> Any:
    """The `mujoco.MjModel` of a vehicle: qpos = pose point (3), quaternion wxyz (4), travel of the wheels, + up (4).

    Args:
        timestep: of one `mj_step` [s].
    """
    import mujoco

    p = parameters
    x, y = p.wheelbase / 2, p.track / 2
    places = ((x, y), (x, -y), (-x, y), (-x, -y))
    # A wheel is a ring about as wide as half its radius: its inertia across is a bit over half of that about its axis.
    inertia = {"mass": p.unsprung_mass, "spin": p.wheel_inertia, "tilt": 0.6 * p.wheel_inertia}
    wheels = "".join(_WHEEL.format(number=i, x=x, y=y, **inertia) for i, (x, y) in enumerate(places))
    xml = _MODEL.format(
        timestep=timestep,
        gravity=GRAVITY,
        com=p.sprung_com,
        mass=p.sprung_mass,
        roll=p.roll_inertia,
        pitch=p.pitch_inertia,
        yaw=p.yaw_inertia,
        wheels=wheels,
    )
    return mujoco.MjModel.from_xml_string(xml)
