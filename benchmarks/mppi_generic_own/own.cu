/* MPPI-Generic plans with LSTM dynamics of its own: RacerDubinsElevationLSTMSteering, of the size its tests have, on a
   map of heights, with the planner and the cost of the exported planner.cu. Prints the median time of a plan for blocks
   of a shape; the best of several is what planner.cu is to be compared with.

       nvcc -std=c++17 -O3 -w -arch=native --extended-lambda -DSAMPLES=1024 -I . -I MPPI-Generic/include -I eigen3 \
           own.cu -o own -lcurand -lcufft && ./own 8 8 */
#include <algorithm>
#include <chrono>
#include <cstdlib>

#include <mppi/cost_functions/cost.cuh>
#include <mppi/controllers/MPPI/mppi_controller.cuh>
#include <mppi/dynamics/racer_dubins/racer_dubins_elevation_lstm_steering.cuh>
#include <mppi/feedback_controllers/DDP/ddp.cuh>
#include <mppi/sampling_distributions/colored_noise/colored_noise.cuh>

#ifndef SAMPLES
#define SAMPLES 1024
#endif

using Vehicle = RacerDubinsElevationLSTMSteering;
using Params = Vehicle::DYN_PARAMS_T;
using Output = Params::OutputIndex;

/* The cost of offpiste_cost.cuh: to a goal, at a speed, without sliding sideways. */
class GoalCost : public Cost<GoalCost, CostParams<2>, Params> {
public:
    explicit GoalCost(cudaStream_t stream = nullptr) { this->bindToStream(stream); }
    std::string getCostFunctionName() const override { return "goal"; }
    float computeStateCost(const Eigen::Ref<const output_array> y, int, int*) { return of(y.data()); }
    __device__ float computeStateCost(float* y, int, float*, int*) { return of(y); }
    float terminalCost(const Eigen::Ref<const output_array>) { return 0.0f; }
    __device__ float terminalCost(float*, float*) { return 0.0f; }

protected:
    __host__ __device__ float of(const float* y) const {
        const float x = y[(int)Output::BASELINK_POS_I_X] - 20.0f, z = y[(int)Output::BASELINK_POS_I_Y] - 5.0f;
        const float faster = y[(int)Output::BASELINK_VEL_B_X] - 5.0f, slide = y[(int)Output::BASELINK_VEL_B_Y];
        return sqrtf(x * x + z * z) + faster * faster + slide * slide;
    }
};

const int STEPS = 250;
using Feedback = DDPFeedback<Vehicle, STEPS>;
using Sampler = mppi::sampling_distributions::ColoredNoiseDistribution<Params>;
using Planner = VanillaMPPIController<Vehicle, GoalCost, Feedback, STEPS, SAMPLES, Sampler>;

/* Weights of about the size that trained ones have. */
static std::vector<float> drawn(size_t count) {
    static unsigned state = 1;
    std::vector<float> values(count);
    for (float& value : values) {
        state = 1664525u * state + 1013904223u;
        value = (float)(state >> 8) / 8388608.0f * 0.4f - 0.4f;
    }
    return values;
}

static void set_map(Vehicle& dynamics) {
    cudaExtent extent = make_cudaExtent(400, 400, 0);
    std::vector<float> heights(extent.width * extent.height);
    for (size_t row = 0; row < extent.height; row++)
        for (size_t column = 0; column < extent.width; column++)
            heights[row * extent.width + column] = 0.5f * sinf(0.05f * row) + 0.3f * cosf(0.04f * column);
    TwoDTextureHelper<float>* map = dynamics.getTextureHelper();
    map->setExtent(0, extent);
    map->updateOrigin(0, make_float3(-40.0f, -40.0f, 0.0f));
    map->updateTexture(0, heights);
    map->updateResolution(0, 0.2f);
    map->enableTexture(0);
    map->copyToDevice(true);
}

static float median_of(dim3 block, Vehicle& dynamics, GoalCost& cost, Sampler& sampler, int turns) {
    Feedback feedback(&dynamics, 0.02f);
    Planner::TEMPLATED_PARAMS settings;
    settings.dt_ = 0.02f;
    settings.lambda_ = 3.0f;
    settings.dynamics_rollout_dim_ = block;
    settings.cost_rollout_dim_ = dim3(64, 1, 1);
    Planner planner(&dynamics, &cost, &feedback, &sampler, settings);
    Vehicle::state_array state = Vehicle::state_array::Zero();
    state((int)Params::StateIndex::VEL_X) = 5.0f;
    std::vector<float> taken;
    for (int turn = 0; turn < turns + 5; turn++) {
        const auto before = std::chrono::steady_clock::now();
        planner.computeControl(state, 1);
        const std::chrono::duration<float, std::milli> time = std::chrono::steady_clock::now() - before;
        if (turn >= 5) taken.push_back(time.count());
        planner.slideControlSequence(1);
    }
    std::nth_element(taken.begin(), taken.begin() + taken.size() / 2, taken.end());
    return taken[taken.size() / 2];
}

int main(int count, char** arguments) {
    std::vector<int> first = {23, 100, 8}, then = {8, 20, 1};
    Vehicle dynamics(3, 20, first, 4, 4, then, 11);
    auto& network = *dynamics.getHelper()->getLSTMModel();
    std::vector<float> lstm = drawn(network.getNumParams()); /* the memory that rollouts start with, too */
    std::vector<float> output = drawn(network.getOutputModel()->getNumParams());
    network.setAllValues(lstm, output);
    dynamics.GPUSetup();
    set_map(dynamics);

    Sampler::SAMPLING_PARAMS_T noise;
    for (int k = 0; k < Vehicle::CONTROL_DIM; k++) {
        noise.std_dev[k] = 0.15f;
        noise.exponents[k] = 2.0f;
    }
    Sampler sampler(noise);
    GoalCost cost;
    const dim3 block(count > 2 ? atoi(arguments[1]) : 8, count > 2 ? atoi(arguments[2]) : 8, 1);
    const float median = median_of(block, dynamics, cost, sampler, 100);
    printf("MPPI-Generic's own LSTM dynamics: a plan of %d x %d takes %.2f ms in blocks of %u x %u\n", SAMPLES, STEPS,
           median, block.x, block.y);
    return 0;
}
