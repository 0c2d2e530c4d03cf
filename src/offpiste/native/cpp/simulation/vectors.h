/* Vectors, and the axes of a body in the world frame. */

namespace vehicle {

struct Vector {
    double x, y, z;
};

inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector operator*(double scale, Vector a) { return {scale * a.x, scale * a.y, scale * a.z}; }
inline double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector cross(Vector a, Vector b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline Vector unit(Vector a) { return (1.0 / sqrt(dot(a, a) + 1e-300)) * a; }

/* Parts of a vector in a plane: ahead and to the left. */
struct Planar {
    double x, y;
};

inline Planar operator+(Planar a, Planar b) { return {a.x + b.x, a.y + b.y}; }
inline Planar operator*(double scale, Planar a) { return {scale * a.x, scale * a.y}; }
inline double size(Planar a) { return sqrt(a.x * a.x + a.y * a.y); }
inline Planar horizontal(Vector a) { return {a.x, a.y}; }

/* Unit vector along the horizontal part of a vector. */
inline Planar heading(Vector a) {
    const double length = size(horizontal(a)) + 1e-9;
    return {a.x / length, a.y / length};
}

inline double clamp(double value, double low, double high) { return std::min(std::max(value, low), high); }

/* Axes of a body in the world frame. */
struct Axes {
    Vector forward, left, up;
};

/* The body-frame vector in the world frame. */
inline Vector to_world(const Axes& body, Vector v) { return v.x * body.forward + v.y * body.left + v.z * body.up; }

}
