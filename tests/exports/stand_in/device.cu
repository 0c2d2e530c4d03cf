/* The paths of OffpisteDynamics that a GPU takes, here: rollouts from a buffer, constraints, and the example of a cost.
   Prints how far they are from the host's paths. */
#include "offpiste_cost.cuh"
#include "parity.h"

int main() {
    const offpiste_parity p = offpiste_read_parity("parity.bin");
    float* codes = offpiste_code_cells(&p);
    OffpisteDynamics dynamics;
    dynamics.set_map(offpiste_map_of(&p, codes));
    const char* names[] = {"POS_X",       "POS_Y",       "YAW",              "VEL_X", "VEL_Y", "OMEGA_Z",
                           "BRAKE_STATE", "STEER_ANGLE", "STEER_ANGLE_RATE", "ENGINE_RPM"};
    OffpisteDynamics::buffer_trajectory buffer;
    std::map<std::string, float> now;
    for (int k = 0; k < 10; k++) {
        if (OFFPISTE_ABSENT >> k & 1) continue;
        for (int row = -3; row < 10; row++) buffer[names[k]].values.push_back(p.past_states[10 * (row < 0 ? 0 : row) + k]);
        buffer[names[k]].values.push_back(p.start[k]);
        now[names[k]] = p.start[k];
    }
    for (int k = 0; k < 3; k++) {
        std::vector<float>& values = buffer["CONTROL_" + std::to_string(k)].values;
        for (int row = -3; row < 10; row++) values.push_back(p.past_controls[p.controls * (row < 0 ? 0 : row) + k]);
        values.push_back(NAN); /* of now, which is not read */
    }
    OffpisteDynamics::state_array wanted = dynamics.start(p.start, p.past_states, p.past_controls), next, rate;
    OffpisteDynamics::output_array output;
    const bool refused = !dynamics.updateFromBuffer({}) && std::isnan(dynamics.stateFromMap({})(0));
    const bool taken = dynamics.updateFromBuffer(buffer);
    const OffpisteDynamics::state_array named = dynamics.stateFromMap(now);

    std::vector<float> shared(dynamics.SHARED_MEM_REQUEST_GRD_BYTES / sizeof(float));
    float state[OffpisteDynamics::STATE_DIM] = {0.0f}, after[OffpisteDynamics::STATE_DIM], out[10], apart = 0.0f;
    bool within = true;
    for (int k = 0; k < 10; k++) state[k] = p.start[k];
    dynamics.initializeDynamics(state, (float*)nullptr, out, shared.data(), 0.0f, 0.02f);
    for (int k = 0; k < OffpisteDynamics::STATE_DIM; k++)
        apart = fmaxf(apart, fmaxf(fabsf(state[k] - wanted(k)), fabsf(named(k) - wanted(k))));
    OffpisteCost cost;
    for (int t = 0; t < 20; t++) {
        OffpisteDynamics::control_array control;
        float given[3];
        for (int k = 0; k < 3; k++) given[k] = control(k) = 4.0f * p.control[p.controls * t + k];
        dynamics.enforceConstraints(wanted, control);
        dynamics.enforceConstraints(state, given);
        dynamics.step(wanted, next, rate, control, output, (float)t, 0.02f);
        dynamics.step(state, after, nullptr, given, out, shared.data(), (float)t, 0.02f);
        within &= control(0) * control(1) == 0.0f && fabsf(control(2)) <= 1.0f && control(0) <= 1.0f;
        for (int k = 0; k < OffpisteDynamics::STATE_DIM; k++) state[k] = after[k];
        wanted = next;
        for (int k = 0; k < 10; k++) apart = fmaxf(apart, fabsf(out[k] - output(k)));
        apart += fabsf(cost.computeStateCost(out, t, nullptr, nullptr) - cost.computeStateCost(output, t, nullptr));
    }
    printf("refused %d taken %d within %d apart %.2e\n", refused, taken, within, apart);
    return 0;
}
