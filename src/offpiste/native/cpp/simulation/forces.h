/* Forces on the vehicle's bodies, and one small step of its internal states.

   MuJoCo integrates the rigid bodies under these forces. A wheel's spin follows J dw/dt = drive - brake - F r. The body
   receives the ground force at the contact, less J dw/dt about the axle and the gyroscopic torque; drive and brake
   torques are internal to the vehicle. */

namespace vehicle {

/* Smallest ground speed in slip ratios and angles [m/s]; among the forces, only sinkage drag depends on it. */
constexpr double MIN_SLIP_SPEED = 0.5;

struct Command {
    double throttle, brake, steer; /* brake: after its delay */
    double gear;                   /* engaged: 1, 0, -1 */
};

/* Ground under a wheel, its load and slip: WHEEL in simulation/vehicle/physics.py. */
struct Wheel {
    Vector contact; /* [m] */
    Properties properties;
    double load, slip_ratio, slip_angle; /* [N, 1, rad] */
};

/* State of a vehicle besides its rigid bodies: STATE in simulation/vehicle/physics.py. */
struct State {
    double belt_ratio, brake_pressure;
    Steering steering;
    double speeds[5];     /* engine, wheels [rad/s] */
    Planar deflection[4]; /* of the tyres [m] */
    Wheel wheels[4];
    double roof_touched, tree_touched; /* 1 after a contact */
};

/* xfrc_applied of MuJoCo. */
struct BodyForces {
    Wrench world, chassis, wheels[4];
};

/* qfrc_applied of MuJoCo [N, N m]. */
struct JointForces {
    double chassis[6], suspension[4];
};

/* Force of the bristles and resistance of the ground, each (forward, left) in the contact plane [N]. */
struct TyreForce {
    Planar bristles, resistance;
};

/* Force of a loaded tyre; updates its deflection and the slip of the wheel.
   velocity: of the wheel's centre over the ground (forward, left) in the contact plane [m/s]
   rolling: wheel rotation times rolling radius [m/s] */
inline TyreForce tyre_force(
    Planar velocity, double rolling, Planar& deflection, Wheel& wheel, double dt, const Parameters& p) {
    const Properties& ground = wheel.properties;
    const double length = p.relaxation_length;
    const Planar stiffness = {p.slip_stiffness_ratio * ground.cornering_stiffness, ground.cornering_stiffness};
    const Planar sliding = {velocity.x - rolling, velocity.y};
    Planar slip = {
        relax(deflection.x, sliding.x, rolling, length, dt) / length,
        relax(deflection.y, sliding.y, rolling, length, dt) / length};
    slip = limit_slip(slip, stiffness, ground.friction);
    deflection = length * slip;
    const double damping = p.standstill_damping / length * standstill_fade(rolling, p.standstill_speed);
    const Planar bristles = brush_force(slip + damping * sliding, stiffness, ground.friction, wheel.load);

    const double ground_speed = std::max(fabs(velocity.x), MIN_SLIP_SPEED);
    wheel.slip_ratio = clamp(-sliding.x / ground_speed, -1.0, 1.0);
    wheel.slip_angle = atan(velocity.y / ground_speed);
    const double speed = size(velocity) + 1e-12;
    const double drag = wheel.load * (ground.rolling_resistance + ground.sinkage_drag * fabs(wheel.slip_ratio));
    return {bristles, (-drag * tanh(speed / p.resistance_speed) / speed) * velocity};
}

/* Sets the ground force on wheel i and its moment about the wheel's centre; returns the torque on the wheel's spin.
   axle: unit vector along the wheel's axle, to the left, in the world frame */
inline double wheel_forces(
    int i, Vector axle, const Body& body, const Ground& ground, State& state, Wrench& forces, double dt,
    const Parameters& p) {
    const Vector arm = {
        0.5 * p.wheelbase * (is_front(i) ? 1.0 : -1.0), 0.5 * p.track * (i % 2 == 0 ? 1.0 : -1.0), body.at.travel[i]};
    const Vector centre = body.place(arm);
    const Vector velocity = body.velocity(arm) + body.moving.travel[i] * body.axes.up;

    const Plane plane = ground_under(ground, centre, cross(axle, body.axes.up), p);
    const Contact contact = touch(centre, plane, axle, p.wheel_radius);
    Wheel& wheel = state.wheels[i];
    const double load = normal_load(contact.compression, -dot(velocity, plane.normal), p);
    wheel = {contact.point, ground.properties_at(contact.point.x, contact.point.y), load, 0.0, 0.0};
    if (load <= 0.0) {
        state.deflection[i] = {};
        return 0.0;
    }

    const Vector ahead = unit(cross(axle, plane.normal)), side = cross(plane.normal, ahead); /* in the contact plane */
    /* Rotation of the wheel plane moves the contact sideways. */
    const double lean = dot(to_world(body.axes, body.moving.rates), ahead);
    const double loaded_radius = std::max(p.wheel_radius - contact.compression, 0.0);
    const Planar over_ground = {dot(velocity, ahead), dot(velocity, side) + lean * loaded_radius};
    const double rolling = state.speeds[i + 1] * p.rolling_radius;
    const TyreForce tyre = tyre_force(over_ground, rolling, state.deflection[i], wheel, dt, p);
    /* Friction limits the whole horizontal force, including that of a locked wheel that plows. */
    const Planar total = limit_force(tyre.bristles + tyre.resistance, wheel.properties.friction * load);
    forces.force = total.x * ahead + total.y * side + load * plane.normal;
    forces.torque = cross(contact.point - centre, forces.force);
    return -tyre.bristles.x * p.rolling_radius;
}

/* Spring, damper and anti-roll bar of a wheel. */
struct Suspension {
    double spring, damper, anti_roll; /* [N/m, N s/m, N/m] */
    double load;                      /* of the spring at rest [N] */
};

/* Force of spring, damper, anti-roll bar and stops, pushing the wheel down and the chassis up [N].
   travel, rate: travel of the wheel from rest, positive up [m], and its rate [m/s]
   other: travel of the opposite wheel [m] */
inline double suspension_force(double travel, double rate, double other, const Suspension& s, const Parameters& p) {
    const double damping = s.damper * (rate > 0.0 ? 1.0 - p.damper_asymmetry : 1.0 + p.damper_asymmetry);
    double force = std::max(s.load + s.spring * travel, 0.0) + damping * rate + s.anti_roll * (travel - other);
    const double over = travel - p.bump_travel, under = -p.droop_travel - travel;
    if (over > 0.0) force += std::max(p.stop_stiffness * over + p.stop_damping * rate, 0.0);
    if (under > 0.0) force -= std::max(p.stop_stiffness * under - p.stop_damping * rate, 0.0);
    return force;
}

/* Advances actuators, engine, wheel spins and tyres by dt, and writes the forces on the bodies. */
inline void substep(
    const Command& command, const Around& around, const Ground& ground, const Body& body, State& state,
    BodyForces& forces, JointForces& joint_forces, double dt, const Parameters& p) {
    double* speeds = state.speeds;
    state.brake_pressure = braked_pressure(state.brake_pressure, command.brake, dt, p);
    state.steering = steered(state.steering, command.steer, dt, p);
    const double shaft = command.gear * p.final_ratio * 0.25 * (speeds[1] + speeds[2] + speeds[3] + speeds[4]);
    state.belt_ratio = shifted_ratio(state.belt_ratio, shaft, command.throttle, dt, p);

    forces = {};
    const FrontAngles front = wheel_angles(state.steering.angle, p);
    const double angles[4] = {front.left, front.right, 0.0, 0.0};
    Vector axles[4];
    double before[4], tyre_torque[4];
    for (int i = 0; i < 4; i++) {
        axles[i] = cos(angles[i]) * body.axes.left - sin(angles[i]) * body.axes.forward;
        before[i] = speeds[i + 1];
        tyre_torque[i] = wheel_forces(i, axles[i], body, ground, state, forces.wheels[i], dt, p);
    }
    spin(speeds, command.gear * state.belt_ratio, command.throttle, state.brake_pressure, tyre_torque, dt, p);

    /* MuJoCo has no wheel spin: apply the change and the precession of its angular momentum to the body. */
    const Vector rates = to_world(body.axes, body.moving.rates);
    for (int i = 0; i < 4; i++) {
        const double acceleration = (speeds[i + 1] - before[i]) / dt;
        const Vector change = acceleration * axles[i] + speeds[i + 1] * cross(rates, axles[i]);
        forces.wheels[i].torque = forces.wheels[i].torque - p.wheel_inertia * change;
    }

    const Suspension axle_springs[2] = {
        {p.spring_front, p.damper_front, p.anti_roll_front, p.spring_load_front},
        {p.spring_rear, p.damper_rear, p.anti_roll_rear, p.spring_load_rear}};
    const double *travel = body.at.travel, *rate = body.moving.travel;
    for (int i = 0; i < 4; i++)
        joint_forces.suspension[i] = -suspension_force(travel[i], rate[i], travel[i ^ 1], axle_springs[i / 2], p);

    drag(around.bush_drag, body, p, forces.chassis);
    const auto touched = [&](double middle, double ahead, double aside, double above) {
        return touch_ground_with_corners(middle, ahead, aside, above, ground, body, p, forces.chassis);
    };
    touched(0.0, 0.5 * p.length, 0.5 * p.width, p.bumper_height);
    touched(0.0, 0.25 * p.wheelbase, 0.25 * p.width, p.belly_height);
    if (touched(-0.1 * p.length, 0.2 * p.length, 0.425 * p.width, p.roof_height)) state.roof_touched = 1.0;
    if (around.tree.radius > 0.0 && touch_tree(around.tree, body, p, forces.chassis)) state.tree_touched = 1.0;
}

/* Runs `substep` and MuJoCo's step `count` times among the obstacles around the vehicle at the start.
   mj_step, model, data: addresses of MuJoCo's function and its arguments, whose qpos, qvel, xfrc_applied and
   qfrc_applied the others are */
OFFPISTE_ENTRY(substeps)(
    int64_t count, int64_t mj_step, int64_t model, int64_t data, const double* elevation, const double* properties,
    int64_t rows, int64_t columns, double x0, double y0, double resolution, const Tree* trees, int64_t tree_count,
    const Bush* bushes, int64_t bush_count, const Command* command, const Positions* positions,
    const Velocities* velocities, State* state, BodyForces* forces, JointForces* joint_forces, double dt,
    const Parameters* p) {
    const auto step = reinterpret_cast<void (*)(const void*, void*)>(mj_step);
    const Ground ground = {elevation, properties, rows, columns, x0, y0, resolution};
    Body body = {*positions, *velocities, axes_of(*positions)};
    const Around around = look_around({trees, tree_count, bushes, bush_count}, body, *p);
    for (int64_t k = 0; k < count; k++) {
        body.axes = axes_of(*positions);
        substep(*command, around, ground, body, *state, *forces, *joint_forces, dt, *p);
        step(reinterpret_cast<const void*>(model), reinterpret_cast<void*>(data));
    }
}

/* For tests. */
OFFPISTE_ENTRY_OF(double, suspension_force)(
    double travel, double rate, double other, double spring, double damper, double anti_roll, double load,
    const Parameters* p) {
    return suspension_force(travel, rate, other, {spring, damper, anti_roll, load}, *p);
}

}
