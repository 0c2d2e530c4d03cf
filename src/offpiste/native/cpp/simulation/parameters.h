/* Parameters of a vehicle, all double: RECORD in simulation/vehicle/parameters.py. Meaning, units and sources are in
   side_by_side.toml. */

namespace vehicle {

struct Parameters {
    double wheelbase, track, mass, front_share, com_height, roll_inertia, pitch_inertia, yaw_inertia;
    double length, width, belly_height, bumper_height, roof_height, drag_area, air_density;

    double unsprung_mass, spring_front, spring_rear, damper_front, damper_rear, damper_asymmetry;
    double anti_roll_front, anti_roll_rear, bump_travel, droop_travel, stop_stiffness, stop_damping;

    double wheel_radius, rolling_radius, tyre_width, tyre_stiffness, tyre_damping, rim_deflection, rim_stiffness;
    double wheel_inertia, slip_stiffness_ratio, relaxation_length, standstill_damping, standstill_speed;
    double envelope_length, resistance_speed;

    double engine_torque, engine_torque_speed, engine_torque_bend, engine_drag, engine_drag_slope, engine_inertia;
    double idle_speed, idle_gain, limiter_speed, limiter_band;

    double ratio_low, ratio_high, final_ratio, shift_time, gear_time, cruise_speed, power_speed;
    double clutch_speed, clutch_gain, clutch_rate, centre_rate, front_rate, rear_rate, shaft_drag, shaft_drag_slope;

    double brake_torque, brake_front_share, brake_delay, brake_time;
    double max_steer, max_steer_rate, steer_frequency, steer_damping;

    double spring_load_front, spring_load_rear; /* of one spring at rest [N] */
    Vector sprung_com;                          /* centre of the sprung mass from the pose point [m] */
};

}
