/* What an exported dynamics class needs of MPPI-Generic, Eigen and CUDA, for a compiler of C++ alone: interfaces with
   the least behind them, so that exported files can be compiled and run where none of the three is. */
#pragma once
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#define __device__
#define __host__
#define HANDLE_ERROR(call) (void)(call)
#define cudaMemcpyHostToDevice 1
typedef void* cudaStream_t;
typedef struct { float x, y; } float2;
typedef struct { float x, y, z; } float3;
typedef struct { float x, y, z, w; } float4;
struct cudaExtent { size_t width, height, depth; };
static float2 make_float2(float x, float y) { return {x, y}; }
static float3 make_float3(float x, float y, float z) { return {x, y, z}; }
static inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }
static struct { int x, y, z; } threadIdx = {0, 0, 0}, blockDim = {1, 1, 1};
static inline void __syncthreads() {}
static inline int cudaMemcpyAsync(void*, const void*, size_t, int, cudaStream_t) { return 0; }

namespace Eigen {
struct VectorXf {
    std::vector<float> values;
    long rows() const { return (long)values.size(); }
    float operator()(int k) const { return values[k]; }
};
template <class T, int N, int M>
struct Matrix {
    T values[N];
    T* data() { return values; }
    const T* data() const { return values; }
    T& operator()(int k) { return values[k]; }
    const T& operator()(int k) const { return values[k]; }
    static Matrix Constant(T value) {
        Matrix result;
        for (T& one : result.values) one = value;
        return result;
    }
    static Matrix Zero() { return Constant(0); }
};
template <class T>
using Ref = T&;
}  // namespace Eigen

struct Logger {
    template <class... T>
    void warning(const char* text, T... values) { fprintf(stderr, text, values...); }
};

struct Managed {
    cudaStream_t stream_ = nullptr;
    bool GPUMemStatus_ = false;
    int SHARED_MEM_REQUEST_GRD_BYTES = 0;
    std::shared_ptr<Logger> logger_ = std::make_shared<Logger>();
    void bindToStream(cudaStream_t stream) { stream_ = stream; }
};

struct DynamicsParams {};

namespace MPPI_internal {
template <class CLASS_T, class PARAMS_T>
class Dynamics : public Managed {
public:
    static const int STATE_DIM = (int)PARAMS_T::StateIndex::NUM_STATES;
    static const int CONTROL_DIM = (int)PARAMS_T::ControlIndex::NUM_CONTROLS;
    static const int OUTPUT_DIM = (int)PARAMS_T::OutputIndex::NUM_OUTPUTS;
    using state_array = Eigen::Matrix<float, STATE_DIM, 1>;
    using control_array = Eigen::Matrix<float, CONTROL_DIM, 1>;
    using output_array = Eigen::Matrix<float, OUTPUT_DIM, 1>;
    using buffer_trajectory = std::map<std::string, Eigen::VectorXf>;

    explicit Dynamics(cudaStream_t) {}
    virtual ~Dynamics() {}
    virtual std::string getDynamicsModelName() const { return ""; }
    virtual state_array stateFromMap(const std::map<std::string, float>& map) = 0;
    void GPUSetup() {}
    void freeCudaMem() {}
    void paramsToDevice() {}
    void setControlRanges(std::array<float2, CONTROL_DIM>& ranges) { ranges_ = ranges; }
    PARAMS_T getParams() { return params_; }

    template <class T>
    bool lacks(const T& map, const std::vector<std::string>& keys) {
        for (const std::string& key : keys)
            if (!map.count(key)) return true;
        return false;
    }
    bool checkIfKeysInBuffer(const buffer_trajectory& buffer, std::vector<std::string>& keys) { return lacks(buffer, keys); }
    bool checkIfKeysInMap(const std::map<std::string, float>& map, std::vector<std::string>& keys) { return lacks(map, keys); }

    void enforceConstraints(Eigen::Ref<state_array>, Eigen::Ref<control_array> control) { clamp(control.data()); }
    void enforceConstraints(float*, float* control) { clamp(control); }
    void initializeDynamics(
        const Eigen::Ref<const state_array>& state, const Eigen::Ref<const control_array>&,
        Eigen::Ref<output_array> output, float, float) {
        for (int k = 0; k < OUTPUT_DIM; k++) output(k) = state(k);
    }

    CLASS_T* model_d_ = nullptr;

protected:
    PARAMS_T params_;
    bool requires_buffer_ = false;

private:
    std::array<float2, CONTROL_DIM> ranges_;
    void clamp(float* control) {
        for (int k = 0; k < CONTROL_DIM; k++) control[k] = fminf(fmaxf(ranges_[k].x, control[k]), ranges_[k].y);
    }
};
}  // namespace MPPI_internal
