/* A planner: MPPI-Generic's controller with coloured noise on the map of a parity file, from its first drive, for 5 s.
   Needs a GPU. -DSAMPLES=8192 for more than 1024 samples.

       nvcc -std=c++17 -O3 -w -arch=native --extended-lambda -I MPPI-Generic/include -I eigen3 planner.cu -o planner \
           -lcurand -lcufft && ./planner parity.bin */
#include <algorithm>
#include <chrono>
#include <vector>

#include <mppi/controllers/MPPI/mppi_controller.cuh>
#include <mppi/feedback_controllers/DDP/ddp.cuh>
#include <mppi/sampling_distributions/colored_noise/colored_noise.cuh>

#include "offpiste_cost.cuh"
#include "parity.h"

#ifndef SAMPLES
#define SAMPLES 1024
#endif

const int STEPS = 250;
using Feedback = DDPFeedback<OffpisteDynamics, STEPS>;
using Sampler = mppi::sampling_distributions::ColoredNoiseDistribution<OffpisteParams>;
using Planner = VanillaMPPIController<OffpisteDynamics, OffpisteCost, Feedback, STEPS, SAMPLES, Sampler>;

int main(int count, char** arguments) {
    const offpiste_parity p = offpiste_read_parity(count > 1 ? arguments[1] : "parity.bin");
    float* codes = offpiste_code_cells(&p);
    OffpisteDynamics dynamics;
    dynamics.set_map(offpiste_map_of(&p, codes));
    OffpisteDynamics::state_array state = dynamics.start(p.start, p.past_states, p.past_controls), next, rate;
    OffpisteDynamics::output_array output;

    OffpisteCost cost;
    OffpisteCostParams wanted;
    wanted.goal[0] = state(0) + 20.0f;
    wanted.goal[1] = state(1) + 5.0f;
    cost.setParams(wanted);

    Sampler::SAMPLING_PARAMS_T noise;
    for (int k = 0; k < OffpisteDynamics::CONTROL_DIM; k++) {
        noise.std_dev[k] = 0.15f;
        noise.exponents[k] = 2.0f;
    }
    Sampler sampler(noise);
    Feedback feedback(&dynamics, 0.02f);
    Planner::TEMPLATED_PARAMS settings; /* given at once: the constructor times kernels of these blocks */
    settings.dt_ = 0.02f;
    settings.lambda_ = 3.0f;
    settings.dynamics_rollout_dim_ = dim3(64, 1, 1); /* a step is one thread's work */
    settings.cost_rollout_dim_ = dim3(64, 1, 1);
    Planner planner(&dynamics, &cost, &feedback, &sampler, settings);

    std::vector<double> times;
    for (int t = 0; t < STEPS; t++) {
        const auto before = std::chrono::steady_clock::now();
        planner.computeControl(state, 1);
        const std::chrono::duration<double, std::milli> taken = std::chrono::steady_clock::now() - before;
        times.push_back(taken.count());
        OffpisteDynamics::control_array control = planner.getControlSeq().col(0);
        dynamics.step(state, next, rate, control, output, (float)t, 0.02f);
        state = next;
        planner.slideControlSequence(1);
        if (t % 25 == 24)
            printf("%.2f s: x %.2f m, y %.2f m, %.2f m/s\n", 0.02 * (t + 1), state(0), state(1), state(3));
    }
    std::nth_element(times.begin(), times.begin() + STEPS / 2, times.end());
    printf("a plan of %d x %d takes %.2f ms\n", SAMPLES, STEPS, times[STEPS / 2]);
    return 0;
}
