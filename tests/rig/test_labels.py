"""Names and units in the headers of tables and the fields of topics."""

import pytest

from offpiste.rig.labels import (
    Label,
    channel_unit,
    is_beside_quantity,
    parse_label,
    unit_by_rate,
    unit_of,
)


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("x(m)", "x", "m"), ("phi(rad)", "phi", "rad"), ("vx [m/s]", "vx", "m/s"), ("steer_deg", "steer", "deg"),
        ("yaw (deg)", "yaw", "deg"), ("speed_kmh", "speed", "km/h"), ("t[ms]", "t", "ms"), ("time_us", "time", "us"),
        ("throttle_%", "throttle", "percent"), ("X_m", "x", "m"), ("speedKmh", "speed", "km/h"), ("posX", "pos_x", ""),
        ("x / m", "x", "m"), ("v / (m/s)", "v", "m/s"), ("yaw, deg", "yaw", "deg"), ("vx_m_s", "vx", "m/s"),
        ("w_deg_s", "w", "deg/s"), ("yaw°", "yaw", "deg"), ("accel [m/s²]", "accel", "m/s²"), ("ax_m_s2", "ax", "m/s2"),
        ("w_RS_S_x [rad s^-1]", "w_rs_s_x", "rad/s"),
        # These say no unit.
        ("W (IMU)", "w (imu)", ""), ("axes[0]", "axes[0]", ""), ("pose.pose.position.x", "pose.pose.position.x", ""),
        ("yaw_psi", "yaw_psi", ""), ("secs", "secs", ""), ("m", "m", ""), ("section", "section", ""), ("", "", ""),
        # Revolutions name the quantity as well.
        ("engine_rpm", "engine_rpm", "rev/min"),
    ],
)  # fmt: skip
def test_labels(header: str, name: str, unit: str) -> None:
    assert parse_label(header) == Label(name, unit)


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("Vitesse véhicule [km/h]", "vehicle_speed", "km/h"), ("velocidad_kmh", "speed", "km/h"),
        ("車速[km/h]", "vehicle_speed", "km/h"), ("Fahrzeuggeschwindigkeit", "vehicle_speed", ""),
        ("Angle volant (°)", "steering_wheel_angle", "deg"), ("angolo_volante", "steering_wheel_angle", ""),
        ("Lenkwinkel_deg", "steering_angle", "deg"), ("舵角", "steering_angle", ""),
        ("Accélérateur %", "accelerator", "percent"), ("Gaspedal", "accelerator", ""), ("freno", "brake", ""),
        ("Pression frein [bar]", "brake_pressure", "bar"), ("ブレーキ圧", "brake_pressure", ""),
        ("velocidad de guiñada", "yaw_rate", ""), ("Gierrate", "yaw_rate", ""), ("Temps (s)", "time", "s"),
        # These are none of these words: parts of others, temperatures, and the sign of a yaw rate.
        ("brake_temps", "brake_temps", ""), ("temporal", "temporal", ""), ("加速度", "加速度", ""),
        ("freinte", "freinte", ""), ("VZ_Gierrate", "vz_gierrate", ""),
        # What a pedal's sensor gives, and pressures.
        ("APPS_mV", "apps", "mv"), ("BPS [mV]", "bps", "mv"), ("Brake [kPa]", "brake", "kpa"), ("p_kPa", "p", "kpa"),
        ("data.mSpeed", "data.m_speed", ""),
    ],
)  # fmt: skip
def test_names_in_other_languages_and_of_sensors(header: str, name: str, unit: str) -> None:
    assert parse_label(header) == Label(name, unit)


@pytest.mark.parametrize(
    ("channel", "unit", "said"),
    [
        ("position", "m", ""), ("position", "mm", "mm"), ("position", "m/s", None), ("yaw", "deg", "deg"),
        ("linear_velocity", "ms", ""), ("linear_velocity", "km/h", "km/h"), ("throttle", "percent", "percent"),
        ("throttle", "bar", None), ("engine_rpm", "rev/min", "rev/min"), ("steer", "deg", None), ("yaw", "", ""),
    ],
)  # fmt: skip
def test_units_of_channels(channel: str, unit: str, said: str | None) -> None:
    assert channel_unit(channel, unit) == said


def test_cells_of_a_row_of_units() -> None:
    assert [unit_of(cell) for cell in ("[m]", " deg/s ", "-", "", "°", "1", "abc", "3.5")] == [
        "m", "deg/s", "", "", "deg", "", None, None,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("rate", "unit", "said"),
    [(50.0, "s", "s"), (0.05, "s", "ms"), (50e-6, "s", "us"), (50e-9, "s", "ns"), (50e3, "ms", "s")],
)
def test_the_unit_of_stamps_by_their_rate(rate: float, unit: str, said: str) -> None:
    assert unit_by_rate(rate, unit) == said
    assert unit_by_rate(float("inf"), unit) == unit_by_rate(float("nan"), unit) == unit


BESIDE = ("rate_limit", "enable", "steering_limit", "pacmod_fault", "Max_Steer", "SteerAngleOk")
QUANTITIES = (
    "status.steering_angle", "vehicle_status_throttle", "steer_count", "override.steer", "mode_throttle",
)  # fmt: skip


@pytest.mark.parametrize("field", [*BESIDE, *QUANTITIES])
def test_limits_and_switches_are_told_from_quantities(field: str) -> None:
    assert is_beside_quantity(field) == (field in BESIDE)
