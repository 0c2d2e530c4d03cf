/* Drive train: engine, CVT, four-wheel drive, brakes and steering.

   Engine and wheels are five inertias (engine, then the wheels). Couplings convert slip into torque: a centrifugal
   clutch with the belt's ratio behind it, a rigid centre coupling, an open front and a viscous rear differential. One
   implicit step solves all of them; couplings and brakes are passive, so stiff ones do not oscillate. */

namespace vehicle {

/* Wheel speed below which a brake acts like stiff viscous friction instead of dry friction [rad/s]. */
constexpr double COULOMB_SPEED = 1e-4;

inline bool is_front(int wheel) { return wheel < 2; }

/* Torque of the engine with limiter and idle governor at a speed [rad/s] and throttle 0..1 [N m]. */
inline double engine_torque(double speed, double throttle, const Parameters& p) {
    const double bend = (speed - p.engine_torque_speed) / p.engine_torque_speed;
    const double full = p.engine_torque * std::max(1.0 - p.engine_torque_bend * bend * bend, 0.0);
    const double open_share = throttle * clamp((p.limiter_speed - speed) / p.limiter_band, 0.0, 1.0);
    const double drag = (p.engine_drag + p.engine_drag_slope * speed) * std::min(speed / 10.0, 1.0);
    const double idle = p.idle_gain * std::max(p.idle_speed - speed, 0.0) * (1.0 - throttle);
    return open_share * full - (1.0 - open_share) * drag + idle;
}

/* Belt ratio (engine over secondary shaft) one step later; it lags behind the wanted engine speed.
   shaft_speed: speed of the secondary shaft [rad/s] */
inline double shifted_ratio(double ratio, double shaft_speed, double throttle, double dt, const Parameters& p) {
    const double wanted_speed = p.cruise_speed + (p.power_speed - p.cruise_speed) * throttle;
    const double wanted = clamp(wanted_speed / std::max(shaft_speed, 1.0), p.ratio_high, p.ratio_low);
    return ratio + (wanted - ratio) * dt / (p.shift_time + dt);
}

/* Torque over slip of the centrifugal clutch, limited by its capacity [N m s/rad].
   engine_speed: [rad/s]
   slip: engine speed minus the speed behind the clutch; the faster side engages it, as a sprag clutch does */
inline double clutch_rate(double engine_speed, double slip, const Parameters& p) {
    const double speed = std::max(engine_speed, engine_speed - slip);
    const double capacity = p.clutch_gain * std::max(speed * speed - p.clutch_speed * p.clutch_speed, 0.0);
    return std::min(p.clutch_rate, capacity / std::max(fabs(slip), 1e-6));
}

/* Equations M speeds = torques / dt of one implicit step: rows of M with the right side as last column. */
struct Equations {
    double rows[5][6];

    /* A coupling whose slip is u . speeds and whose torques are -rate (u . speeds) u adds rate u u^T. */
    void couple(double rate, const double (&u)[5]) {
        for (int i = 0; i < 5; i++)
            for (int j = 0; j < 5; j++) rows[i][j] += rate * u[i] * u[j];
    }

    /* Gaussian elimination without pivoting: M is symmetric and positive definite. */
    void solve(double* solution) {
        for (int k = 0; k < 5; k++)
            for (int i = k + 1; i < 5; i++) {
                const double factor = rows[i][k] / rows[k][k];
                for (int j = k; j < 6; j++) rows[i][j] -= factor * rows[k][j];
            }
        for (int k = 4; k >= 0; k--) {
            double value = rows[k][5];
            for (int j = k + 1; j < 5; j++) value -= rows[k][j] * solution[j];
            solution[k] = value / rows[k][k];
        }
    }
};

/* Advances engine and wheels by one step.
   speeds: engine, wheels [5] [rad/s]
   ratio: belt ratio, negative in reverse, 0 in neutral
   throttle, brake: throttle and brake pressure, 0..1
   tyre_torque: torque of the ground on the wheels [4] [N m] */
inline void spin(
    double* speeds, double ratio, double throttle, double brake, const double* tyre_torque, double dt,
    const Parameters& p) {
    Equations equations = {};
    double(*rows)[6] = equations.rows;
    rows[0][0] = p.engine_inertia / dt;
    rows[0][5] = p.engine_inertia / dt * speeds[0] + engine_torque(speeds[0], throttle, p);
    for (int i = 0; i < 4; i++) {
        const double share = is_front(i) ? p.brake_front_share : 1.0 - p.brake_front_share;
        const double dry = 0.5 * share * brake * p.brake_torque + p.shaft_drag;
        const double hold = dry / std::max(fabs(speeds[i + 1]), COULOMB_SPEED) + p.shaft_drag_slope;
        rows[i + 1][i + 1] = p.wheel_inertia / dt + hold;
        rows[i + 1][5] = p.wheel_inertia / dt * speeds[i + 1] + tyre_torque[i];
    }
    const double total = ratio * p.final_ratio, side = -0.25 * total;
    const double slip = speeds[0] - total * 0.25 * (speeds[1] + speeds[2] + speeds[3] + speeds[4]);
    equations.couple(ratio != 0.0 ? clutch_rate(speeds[0], slip, p) : 0.0, {1.0, side, side, side, side});
    equations.couple(p.centre_rate, {0.0, 0.5, 0.5, -0.5, -0.5});
    equations.couple(p.front_rate, {0.0, 1.0, -1.0, 0.0, 0.0});
    equations.couple(p.rear_rate, {0.0, 0.0, 0.0, 1.0, -1.0});
    equations.solve(speeds);
    speeds[0] = std::max(speeds[0], 0.0);
}

/* Brake pressure one step later: a first-order lag behind the (delayed) command 0..1. */
inline double braked_pressure(double pressure, double command, double dt, const Parameters& p) {
    return pressure + (command - pressure) * dt / (p.brake_time + dt);
}

struct Steering {
    double angle, rate; /* of a wheel midway between the front wheels [rad], [rad/s] */
};

/* Steering one step later, both limited; command -1..1, positive left. */
inline Steering steered(Steering now, double command, double dt, const Parameters& p) {
    const double frequency = p.steer_frequency;
    const double pull =
        frequency * frequency * (command * p.max_steer - now.angle) - 2.0 * p.steer_damping * frequency * now.rate;
    const double rate = clamp(now.rate + pull * dt, -p.max_steer_rate, p.max_steer_rate);
    const double angle = now.angle + rate * dt;
    if (fabs(angle) > p.max_steer) return {clamp(angle, -p.max_steer, p.max_steer), 0.0};
    return {angle, rate};
}

/* Ackermann angles of the front wheels for the angle of a wheel midway between them [rad]. */
struct FrontAngles {
    double left, right;
};

inline FrontAngles wheel_angles(double angle, const Parameters& p) {
    const double curvature = tan(angle) / p.wheelbase, side = 0.5 * p.track * curvature;
    return {atan(p.wheelbase * curvature / (1.0 - side)), atan(p.wheelbase * curvature / (1.0 + side))};
}

OFFPISTE_ENTRY_OF(double, engine_torque)(double speed, double throttle, const Parameters* p) {
    return engine_torque(speed, throttle, *p);
}

/* The entries below are for tests. */

OFFPISTE_ENTRY(spin)(
    double* speeds, double ratio, double throttle, double brake, const double* tyre_torque, double dt,
    const Parameters* p) {
    spin(speeds, ratio, throttle, brake, tyre_torque, dt, *p);
}

OFFPISTE_ENTRY(steered)(Steering* steering, double command, double dt, const Parameters* p) {
    *steering = steered(*steering, command, dt, *p);
}

OFFPISTE_ENTRY(wheel_angles)(double angle, const Parameters* p, FrontAngles* found) {
    *found = wheel_angles(angle, *p);
}

}
