/* Forces on the chassis: air, plants, and contact with ground and trees. Contact is a soft penalty that keeps the vehicle
   above ground; it does not model crashes. */

namespace vehicle {

constexpr double TOUCH_STIFFNESS = 80e3, TOUCH_DAMPING = 4e3, TOUCH_FRICTION = 0.5; /* with ground [N/m, N s/m, 1] */
constexpr double TREE_STIFFNESS = 300e3, TREE_DAMPING = 30e3;                       /* with a trunk [N/m, N s/m] */
constexpr double PUSH_SPEED = 0.3; /* below it drag of plants and friction of the body fade out [m/s] */

/* qpos of MuJoCo (`build_bodies` in simulation/vehicle/vehicle.py). */
struct Positions {
    Vector place;      /* of the pose point in the world [m] */
    double w, x, y, z; /* quaternion */
    double travel[4];  /* of the wheels from rest, up [m] */
};

/* Axes of the chassis, from its quaternion. */
inline Axes axes_of(const Positions& at) {
    const double w = at.w, x = at.x, y = at.y, z = at.z;
    return {
        {1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)},
        {2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)},
        {2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)}};
}

/* qvel of MuJoCo. */
struct Velocities {
    Vector linear; /* of the pose point in the world frame [m/s] */
    Vector rates;  /* in the body frame [rad/s] */
    double travel[4];
};

/* A row of xfrc_applied of MuJoCo, in the world frame; the torque is about the body's centre of mass. */
struct Wrench {
    Vector force, torque; /* [N], [N m] */
};

struct Tree {
    double x, y, radius; /* of the trunk [m] */
};

struct Bush {
    double x, y, radius; /* [m] */
    double drag;         /* force on a vehicle that drives through it [N] */
};

struct Plants {
    const Tree* trees;
    int64_t tree_count;
    const Bush* bushes;
    int64_t bush_count;
};

/* Obstacles near the body: the nearest trunk, with radius 0 for none, and the drag of the bushes under it [N]. */
struct Around {
    Tree tree;
    double bush_drag;
};

/* Motion of the chassis; points are in the body frame, from the pose point [m]. */
struct Body {
    const Positions& at;
    const Velocities& moving;
    Axes axes;

    Vector place(Vector point) const { return at.place + to_world(axes, point); }
    Vector velocity(Vector point) const { return moving.linear + to_world(axes, cross(moving.rates, point)); }
};

/* Finds the obstacles near a body. */
inline Around look_around(const Plants& plants, const Body& body, const Parameters& p) {
    Around found = {};
    const Vector place = body.at.place;
    const auto [c, s] = heading(body.axes.forward);
    double nearest = p.length;
    for (int64_t n = 0; n < plants.tree_count; n++) {
        const Tree& tree = plants.trees[n];
        const double gap = size({tree.x - place.x, tree.y - place.y}) - tree.radius;
        if (gap < nearest) nearest = gap, found.tree = tree;
    }
    for (int64_t n = 0; n < plants.bush_count; n++) {
        const Bush& bush = plants.bushes[n];
        const double dx = bush.x - place.x, dy = bush.y - place.y;
        const double ahead = std::max(fabs(c * dx + s * dy) - 0.5 * p.length, 0.0);
        const double aside = std::max(fabs(c * dy - s * dx) - 0.5 * p.width, 0.0);
        if (size({ahead, aside}) < bush.radius) found.bush_drag += bush.drag;
    }
    return found;
}

/* Factor from a velocity to its direction, fading out at standstill. */
inline double direction(double speed) { return tanh(speed / PUSH_SPEED) / (speed + 1e-9); }

/* Adds a world-frame force at a point of the body. */
inline void push(Vector force, Vector point, const Body& body, const Parameters& p, Wrench& chassis) {
    chassis.force = chassis.force + force;
    chassis.torque = chassis.torque + cross(to_world(body.axes, point - p.sprung_com), force);
}

/* Adds drag of air and bushes. */
inline void drag(double bush_drag, const Body& body, const Parameters& p, Wrench& chassis) {
    const Vector velocity = body.moving.linear;
    const double air = 0.5 * p.air_density * p.drag_area * sqrt(dot(velocity, velocity));
    const double bush = bush_drag * direction(size(horizontal(velocity)));
    push({-(air + bush) * velocity.x, -(air + bush) * velocity.y, -air * velocity.z}, p.sprung_com, body, p, chassis);
}

/* Adds the force of the ground on a point of the body; returns whether they touch. */
inline bool touch_ground(Vector point, const Ground& ground, const Body& body, const Parameters& p, Wrench& chassis) {
    const Vector place = body.place(point);
    const double depth = ground.height(place.x, place.y) - place.z;
    if (depth <= 0.0) return false;
    const Vector velocity = body.velocity(point);
    const double load = std::max(TOUCH_STIFFNESS * depth - TOUCH_DAMPING * velocity.z, 0.0);
    const double friction = TOUCH_FRICTION * load * direction(size(horizontal(velocity)));
    push({-friction * velocity.x, -friction * velocity.y, load}, point, body, p, chassis);
    return true;
}

/* Adds the force of the ground on four corners (middle +- ahead, +- aside, above); returns whether one touches. */
inline bool touch_ground_with_corners(
    double middle, double ahead, double aside, double above, const Ground& ground, const Body& body,
    const Parameters& p, Wrench& chassis) {
    bool touched = false;
    for (const double x : {middle + ahead, middle - ahead})
        for (const double y : {aside, -aside}) touched |= touch_ground({x, y, above}, ground, body, p, chassis);
    return touched;
}

/* Adds the force of the nearest tree, a circle in contact with the body's footprint in the plane, at bumper height;
   returns whether they touch. */
inline bool touch_tree(const Tree& trunk, const Body& body, const Parameters& p, Wrench& chassis) {
    const auto [c, s] = heading(body.axes.forward);
    const double dx = trunk.x - body.at.place.x, dy = trunk.y - body.at.place.y;
    const Planar tree = {c * dx + s * dy, c * dy - s * dx};
    const double half = 0.5 * p.length, side = 0.5 * p.width;
    const Planar nearest = {clamp(tree.x, -half, half), clamp(tree.y, -side, side)};
    const Planar gap = {tree.x - nearest.x, tree.y - nearest.y};
    double depth = trunk.radius - size(gap);
    if (depth <= 0.0) return false;
    Planar out = {tree.x > 0.0 ? 1.0 : -1.0, 0.0}; /* direction to the tree */
    if (size(gap) > 1e-6) out = {gap.x / size(gap), gap.y / size(gap)};
    else depth += half - fabs(tree.x); /* the trunk's centre is inside: push out through the nearer end */
    const Vector normal = {c * out.x - s * out.y, s * out.x + c * out.y, 0.0};
    const Vector point = {nearest.x, nearest.y, p.bumper_height};
    const double closing = dot(body.velocity(point), normal);
    const double load = std::max(TREE_STIFFNESS * depth + TREE_DAMPING * closing, 0.0);
    push(-load * normal, point, body, p, chassis);
    return true;
}

}
