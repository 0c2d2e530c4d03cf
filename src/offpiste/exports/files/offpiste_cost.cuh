/* An example of a cost: drive to a goal, at a speed, without sliding sideways. */
#pragma once
#include <mppi/cost_functions/cost.cuh>

#include "offpiste_dynamics.cuh"

struct OffpisteCostParams : public CostParams<3> {
    float goal[2] = {0.0f, 0.0f}; /* [m] */
    float speed = 5.0f;           /* [m/s] */
    float per_metre = 1.0f, per_speed = 1.0f, per_slide = 1.0f;
};

class OffpisteCost : public Cost<OffpisteCost, OffpisteCostParams, OffpisteParams> {
public:
    explicit OffpisteCost(cudaStream_t stream = nullptr) { this->bindToStream(stream); }

    std::string getCostFunctionName() const override { return "offpiste example"; }

    float computeStateCost(const Eigen::Ref<const output_array> y, int timestep, int* crash_status) {
        return of(y.data());
    }

    __device__ float computeStateCost(float* y, int timestep, float* theta_c, int* crash_status) { return of(y); }

    float terminalCost(const Eigen::Ref<const output_array> y) { return 0.0f; }

    __device__ float terminalCost(float* y, float* theta_c) { return 0.0f; }

protected:
    __host__ __device__ float of(const float* y) const {
        const float x = y[0] - this->params_.goal[0], z = y[1] - this->params_.goal[1];
        const float faster = y[3] - this->params_.speed;
        return this->params_.per_metre * sqrtf(x * x + z * z) + this->params_.per_speed * faster * faster +
               this->params_.per_slide * y[4] * y[4];
    }
};
