/* Tyres: contact with the ground, load, and combined slip by a brush model.

   Pacejka, Tire and Vehicle Dynamics, 3rd ed.: the brush model with parabolic pressure (ch. 3.2, 3.3; Fiala 1954 for
   the lateral part) and its transient form with a relaxation length (ch. 7.2, 8.6). Beyond full sliding the force stays
   constant, as on soft ground; on asphalt it would decrease. */

namespace vehicle {

/* Force (forward, left) on the tyre, opposite to slip, at most friction * load (eqs. 3.36, 3.37) [N].
   slip: sliding over rolling velocity, of the tyre over the ground [1]
   stiffness: force over load per slip, at small slip [1]
   friction: largest force over load [1]
   load: [N] */
inline Planar brush_force(Planar slip, Planar stiffness, double friction, double load) {
    const Planar pull = {stiffness.x * slip.x, stiffness.y * slip.y};
    const double strength = size(pull), limit = 3.0 * friction;
    if (strength < 1e-12 || limit <= 0.0) return {0.0, 0.0};
    const double s = std::min(strength / limit, 1.0);
    /* mu F_z (1 - (1 - s)^3) without its cancellation at small slip */
    return (-friction * load * s * (3.0 - s * (3.0 - s)) / strength) * pull;
}

/* Limits the slip to the onset of full sliding, as sliding bristles store no further deflection. */
inline Planar limit_slip(Planar slip, Planar stiffness, double friction) {
    const double excess = size({stiffness.x * slip.x, stiffness.y * slip.y}) / (3.0 * friction + 1e-12);
    return excess <= 1.0 ? slip : Planar{slip.x / excess, slip.y / excess};
}

/* Deflection u of the bristles one step later [m]: du/dt = sliding - |rolling| u / length (eq. 7.9), decaying
   implicitly. u / length is the transient slip; at standstill, u is a spring that holds a parked vehicle.
   length: relaxation length [m]
   sliding: velocity of the tyre over the ground [m/s]
   rolling: wheel rotation times rolling radius [m/s] */
inline double relax(double deflection, double sliding, double rolling, double length, double dt) {
    return (deflection + sliding * dt) / (1.0 + fabs(rolling) * dt / length);
}

/* Weight of a stopped tyre's damping: 1 at standstill, 0 from `fade_speed` on (ch. 8.6). */
inline double standstill_fade(double speed, double fade_speed) {
    return fabs(speed) >= fade_speed ? 0.0 : 0.5 * (1.0 + cos(M_PI * speed / fade_speed));
}

/* Limits a force in size [N]. */
inline Planar limit_force(Planar force, double limit) {
    const double strength = size(force);
    return strength <= limit || strength == 0.0 ? force : (limit / strength) * force;
}

/* Height of the ground under a wheel's centre [m], and its unit normal. */
struct Plane {
    double height;
    Vector normal;
};

/* The ground under a tyre, averaged over five points.
   centre, forward: centre [m] and heading of the wheel in the world frame */
inline Plane ground_under(const Ground& ground, Vector centre, Vector forward, const Parameters& p) {
    const auto [c, s] = heading(forward);
    const double a = p.envelope_length, b = 0.5 * p.tyre_width;
    const double x = centre.x, y = centre.y;
    const double middle = ground.height(x, y);
    const double front = ground.height(x + a * c, y + a * s), back = ground.height(x - a * c, y - a * s);
    const double left = ground.height(x - b * s, y + b * c), right = ground.height(x + b * s, y - b * c);
    const double along = (front - back) / (2.0 * a), across = (left - right) / (2.0 * b);
    return {
        (2.0 * middle + front + back + left + right) / 6.0,
        unit({-along * c + across * s, -along * s - across * c, 1.0})};
}

/* Compression of the tyre in its plane, negative in the air, and the point of contact in the world [m]. */
struct Contact {
    double compression;
    Vector point;
};

/* Contact of a wheel with the ground.
   centre: centre of the wheel [m]
   axle: unit vector along the wheel's axle, to the left
   radius: free radius of the tyre [m] */
inline Contact touch(Vector centre, const Plane& ground, Vector axle, double radius) {
    const Vector radial = unit(ground.normal - dot(ground.normal, axle) * axle);
    const double upright = std::max(dot(radial, ground.normal), 0.2); /* limits a wheel that lies flat */
    const double reach = (centre.z - ground.height) * ground.normal.z / upright;
    return {radius - reach, centre - reach * radial};
}

/* Load of a tyre from spring, damper and rim, at least 0 [N].
   compression, closing: compression [m] and its rate [m/s] */
inline double normal_load(double compression, double closing, const Parameters& p) {
    if (compression <= 0.0) return 0.0;
    const double rim = p.rim_stiffness * std::max(compression - p.rim_deflection, 0.0);
    return std::max(p.tyre_stiffness * compression + p.tyre_damping * closing + rim, 0.0);
}

/* The entries below are for tests. */

OFFPISTE_ENTRY(brush_force)(
    double slip_x, double slip_y, double stiffness_x, double stiffness_y, double friction, double load, double* force) {
    const Planar found = brush_force({slip_x, slip_y}, {stiffness_x, stiffness_y}, friction, load);
    force[0] = found.x, force[1] = found.y;
}

OFFPISTE_ENTRY_OF(double, relax)(double deflection, double sliding, double rolling, double length, double dt) {
    return relax(deflection, sliding, rolling, length, dt);
}

OFFPISTE_ENTRY(ground_under)(
    const double* elevation, int64_t rows, int64_t columns, double x0, double y0, double resolution,
    const Vector* centre, const Vector* forward, const Parameters* p, Plane* found) {
    *found = ground_under({elevation, nullptr, rows, columns, x0, y0, resolution}, *centre, *forward, *p);
}

OFFPISTE_ENTRY(touch)(
    const Vector* centre, const Plane* ground, const Vector* axle, double radius, Contact* found) {
    *found = touch(*centre, *ground, *axle, radius);
}

}
