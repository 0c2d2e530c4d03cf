/* Cost per step of the declared terms, and what they read. */
#define OFFPISTE_LAYERS 6
#define OFFPISTE_NUMBERS 15

typedef struct {
    offpiste_real control[3], cos_yaw, sin_yaw, vx_before, vy_before, layers[OFFPISTE_LAYERS];
    offpiste_real stray[2];
} offpiste_values;

OFFPISTE_FN offpiste_real offpiste_control_cost(
    const float* numbers, const offpiste_real* before, const offpiste_real* control) {
    offpiste_real cost = {0.0f};
    OFFPISTE_UNROLL
    for (int k = 0; k < 3; k++) {
        const float dt = numbers[0];
        const float number_effort = numbers[9 + k];
        const float number_jerk = numbers[12 + k];
        cost += ((number_effort * control[k]) * control[k]);
        cost += ((number_jerk * ((control[k] - before[k]) / dt)) * ((control[k] - before[k]) / dt));
    }
    return numbers[0] * cost;
}

OFFPISTE_FN offpiste_real offpiste_motion_cost(
    const float* numbers, const offpiste_real* state, const offpiste_real* normal,
    const offpiste_values* v) {
    /* Not finite where the place is not. */
    offpiste_real cost = (state[0] - state[0]) + (state[1] - state[1]);
    const float dt = numbers[0];
    const float gravity = numbers[1];
    const float number_path = numbers[2];
    const float number_speed = numbers[3];
    const float number_overspeed = numbers[4];
    const float number_slide = numbers[5];
    const float number_rollover = numbers[6];
    const float number_lateral_limit = numbers[7];
    const float number_least_vertical = numbers[8];
    OFFPISTE_TERM position_margin = ((v->stray[0] * offpiste_maximum(((v->cos_yaw * v->layers[4]) - (v->sin_yaw * v->layers[3])), (-((v->cos_yaw * v->layers[4]) - (v->sin_yaw * v->layers[3]))))) + (v->stray[1] * offpiste_maximum(((v->cos_yaw * v->layers[3]) + (v->sin_yaw * v->layers[4])), (-((v->cos_yaw * v->layers[3]) + (v->sin_yaw * v->layers[4]))))));
    OFFPISTE_TERM speed_along = ((((v->cos_yaw * state[3]) - (v->sin_yaw * state[4])) * v->layers[3]) + (((v->sin_yaw * state[3]) + (v->cos_yaw * state[4])) * v->layers[4]));
    OFFPISTE_TERM lateral_acceleration = (((state[4] - v->vy_before) / dt) + (state[3] * state[5]));
    OFFPISTE_TERM normal_y = ((v->cos_yaw * normal[1]) - (v->sin_yaw * normal[0]));
    OFFPISTE_TERM normal_z = normal[2];
    OFFPISTE_TERM lateral_ratio = (offpiste_maximum(((lateral_acceleration * normal_z) - (gravity * normal_y)), (-((lateral_acceleration * normal_z) - (gravity * normal_y)))) / offpiste_maximum(((lateral_acceleration * normal_y) + (gravity * normal_z)), number_least_vertical));
    cost += ((number_path * (v->layers[2] + position_margin)) * (v->layers[2] + position_margin));
    cost += ((number_speed * (speed_along - v->layers[5])) * (speed_along - v->layers[5]));
    cost += ((number_overspeed * offpiste_maximum((offpiste_maximum(state[3], (-state[3])) - v->layers[1]), (state[3] - state[3]))) * offpiste_maximum((offpiste_maximum(state[3], (-state[3])) - v->layers[1]), (state[3] - state[3])));
    cost += ((number_slide * state[4]) * state[4]);
    cost += v->layers[0];
    cost += ((number_rollover * (lateral_ratio > number_lateral_limit ? 1.0f : 0.0f)) + (number_rollover * offpiste_maximum((lateral_ratio - number_lateral_limit), (lateral_ratio - lateral_ratio))));
    (void)normal;
    return numbers[0] * cost;
}

