/* Drives over the map of a parity file by OffpisteDynamics, on the host, and compares with what offpiste predicts.

       nvcc -std=c++17 -O2 -w -I MPPI-Generic/include -I eigen3 drive.cu -o drive && ./drive parity.bin */
#include "offpiste_dynamics.cuh"
#include "parity.h"

int main(int count, char** arguments) {
    using Dynamics = OffpisteDynamics;
    const offpiste_parity p = offpiste_read_parity(count > 1 ? arguments[1] : "parity.bin");
    float* codes = offpiste_code_cells(&p);
    std::vector<float> states(10 * p.drives * p.steps);
    Dynamics& dynamics = *new Dynamics; /* left to the system: MPPI-Generic frees nothing without a GPU */
    dynamics.set_map(offpiste_map_of(&p, codes));
    for (int drive = 0; drive < p.drives; drive++) {
        const float* past = p.past_states + 10 * p.past * drive;
        Dynamics::state_array state = dynamics.start(
            p.start + 10 * drive, past, p.past_controls + p.controls * p.past * drive);
        Dynamics::state_array next = state, rate = state;
        Dynamics::output_array output;
        Dynamics::control_array control;
        for (int t = 0; t < p.steps; t++) {
            const int at = drive * p.steps + t;
            for (int k = 0; k < Dynamics::CONTROL_DIM; k++) control(k) = p.control[p.controls * at + k];
            dynamics.step(state, next, rate, control, output, (float)t, 0.02f);
            state = next;
            for (int k = 0; k < 10; k++) states[10 * at + k] = output(k);
        }
    }
    return offpiste_report(&p, states.data());
}
