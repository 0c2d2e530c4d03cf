/* The model as dynamics of ACDSLab's MPPI-Generic. A state is that of offpiste.h: ten numbers, then what the networks
   remember, so that starting a rollout is copying one. The step is 0.02 s, whatever dt is.

   Ground: slopes as a texture that is interpolated, codes as textures of the nearest cell (set_map). Past: `start`, or
   `updateFromBuffer` for plants that keep a buffer. Throttle and brake are one pedal: enforceConstraints leaves one of
   them at 0. Rows of a state and of a buffer are named as in StateIndex. */
#pragma once
#include <mppi/dynamics/dynamics.cuh>
#include <mppi/utils/texture_helpers/two_d_texture_helper.cuh>

#include <array>
#include <stdexcept>
#include <string>
#include <vector>

#include "offpiste.h"

#if OFFPISTE_CODES
#define OFFPISTE_TEXTURES ((OFFPISTE_CODE + 3) / 4) /* of codes, four numbers each */
#else
#define OFFPISTE_TEXTURES 1
#endif

struct OffpisteParams : public DynamicsParams {
    enum class StateIndex : int {
        POS_X = 0, POS_Y, YAW, VEL_X, VEL_Y, OMEGA_Z, BRAKE_STATE, STEER_ANGLE, STEER_ANGLE_RATE, ENGINE_RPM, MEMORY,
        NUM_STATES = OFFPISTE_STATE
    };
    enum class ControlIndex : int { THROTTLE = 0, BRAKE, STEER, NUM_CONTROLS };
    enum class OutputIndex : int {
        POS_X = 0, POS_Y, YAW, VEL_X, VEL_Y, OMEGA_Z, BRAKE_STATE, STEER_ANGLE, STEER_ANGLE_RATE, ENGINE_RPM,
        NUM_OUTPUTS
    };
    alignas(16) offpiste_params model = offpiste_model;
    offpiste_grid grid = {0.0f, 0.0f, 1.0f, 0.0f, 0.0f}; /* no cell: unknown ground everywhere */
    float wheels[4][2] = {{0.0f}};
    float missing[4 * OFFPISTE_TEXTURES] = {0.0f};    /* code off the map */
    float memory[OFFPISTE_STATE] = {0.0f};            /* of the networks after the buffer, behind ten zeros */
    bool remembers = false;                           /* rollouts start with that memory */
    float gear = 1.0f;                                /* of models that have one: -1, 0 or 1 */
};

/* Codes of cells, four numbers a texture; the nearest cell counts, since codes between two mean nothing. */
class OffpisteCodes : public TwoDTextureHelper<float4> {
public:
    explicit OffpisteCodes(cudaStream_t stream) : TwoDTextureHelper<float4>(OFFPISTE_TEXTURES, stream) {
        for (auto& texture : this->textures_buffer_) {
            texture.texDesc.filterMode = cudaFilterModePoint;
            texture.update_mem = true;
        }
    }
};

class OffpisteDynamics : public MPPI_internal::Dynamics<OffpisteDynamics, OffpisteParams> {
public:
    using PARENT_CLASS = MPPI_internal::Dynamics<OffpisteDynamics, OffpisteParams>;
    using PARENT_CLASS::initializeDynamics;
    static const int NUMBERS = 10; /* of a state, without what the networks remember */
    static const int PAST = OFFPISTE_PAST; /* rows of 0.02 s before now that these begin with */

    explicit OffpisteDynamics(cudaStream_t stream = nullptr) : PARENT_CLASS(stream) {
        std::array<float2, CONTROL_DIM> ranges = {make_float2(0.0f, 1.0f), make_float2(0.0f, 1.0f), make_float2(-1.0f, 1.0f)};
        this->setControlRanges(ranges);
        slopes_ = new TwoDTextureHelper<float2>(1, stream);
        codes_ = new OffpisteCodes(stream);
        this->requires_buffer_ = OFFPISTE_UNITS > 0;
        this->SHARED_MEM_REQUEST_GRD_BYTES = sizeof(offpiste_params); /* weights, for all threads of a block */
    }

    ~OffpisteDynamics() override {
        freeCudaMem();
        delete slopes_;
        delete codes_;
    }

    std::string getDynamicsModelName() const override { return "offpiste"; }

    void bindToStream(cudaStream_t stream) {
        slopes_->bindToStream(stream);
        codes_->bindToStream(stream);
        PARENT_CLASS::bindToStream(stream);
    }

    void GPUSetup() {
        PARENT_CLASS::GPUSetup();
        slopes_->GPUSetup();
        codes_->GPUSetup();
        HANDLE_ERROR(cudaMemcpyAsync(
            &(this->model_d_->slopes_), &(slopes_->ptr_d_), sizeof(slopes_->ptr_d_), cudaMemcpyHostToDevice,
            this->stream_));
        HANDLE_ERROR(cudaMemcpyAsync(
            &(this->model_d_->codes_), &(codes_->ptr_d_), sizeof(codes_->ptr_d_), cudaMemcpyHostToDevice,
            this->stream_));
    }

    void freeCudaMem() {
        slopes_->freeCudaMem();
        codes_->freeCudaMem();
        PARENT_CLASS::freeCudaMem();
    }

    void paramsToDevice() {
        slopes_->copyToDevice();
        codes_->copyToDevice();
        PARENT_CLASS::paramsToDevice();
    }

    /* The ground from now on; its cells are copied. On the host, and on the GPU after GPUSetup. */
    void set_map(const offpiste_map& map) {
        const int rows = (int)map.grid.rows, columns = (int)map.grid.columns;
        if (rows < 2 || columns < 2) throw std::invalid_argument("offpiste: a map has 2 x 2 cells at least");
        cudaExtent extent = {(size_t)columns, (size_t)rows, 0};
        std::vector<float2> slopes(rows * columns);
        for (int cell = 0; cell < rows * columns; cell++)
            slopes[cell] = make_float2(map.slope[2 * cell], map.slope[2 * cell + 1]);
        slopes_->updateTexture(0, slopes, extent);
#if OFFPISTE_CODES
        for (int n = 0; n < OFFPISTE_TEXTURES; n++) {
            std::vector<float4> codes(rows * columns);
            for (int cell = 0; cell < rows * columns; cell++) {
                float four[4] = {0.0f, 0.0f, 0.0f, 0.0f};
                for (int k = 4 * n; k < OFFPISTE_CODE && k < 4 * n + 4; k++)
                    four[k - 4 * n] = map.codes[OFFPISTE_CODE * cell + k];
                codes[cell] = make_float4(four[0], four[1], four[2], four[3]);
            }
            codes_->updateTexture(n, codes, extent);
        }
        for (int k = 0; k < OFFPISTE_CODE; k++) this->params_.missing[k] = map.missing[k];
#endif
        this->params_.grid = map.grid;
        for (int k = 0; k < 8; k++) this->params_.wheels[k / 2][k % 2] = map.wheels[k / 2][k % 2];
        paramsToDevice();
    }

    /* A whole state from what was measured now and at the 10 rows (0.2 s) before, oldest first: [10], [10, 10],
       [10, OFFPISTE_CONTROLS]. */
    state_array start(const float* measured, const float* past_states, const float* past_controls) {
        state_array state = state_array::Zero();
        offpiste_given given[PAST];
        for (int k = 0; k < NUMBERS; k++) state(k) = measured[k];
        for (int row = 0; row < PAST; row++) {
            look(past_states + NUMBERS * row, given + row);
            for (int k = 0; k < OFFPISTE_CONTROLS; k++)
                given[row].control[k] = past_controls[OFFPISTE_CONTROLS * row + k];
        }
        offpiste_start(&this->params_.model, &offpiste_starts, past_states, given, PAST, state.data());
        return state;
    }

    /* What the networks remember, from a buffer of rows 0.02 s apart up to now, as BufferedPlant keeps it. Rollouts on
       the GPU then start with it, whatever the state that they are given remembers. */
    bool updateFromBuffer(const buffer_trajectory& buffer) {
        std::vector<std::string> wanted = keys();
        for (int k = 0; k < CONTROL_DIM; k++) wanted.push_back("CONTROL_" + std::to_string(k));
        if (this->checkIfKeysInBuffer(buffer, wanted)) return false;
        const int first = (int)buffer.at("POS_X").rows() - (PAST + 1);
        if (first < 0) {
            this->logger_->warning("offpiste: the buffer has fewer than %d rows\n", PAST + 1);
            return false;
        }
        float states[PAST + 1][NUMBERS] = {{0.0f}}, controls[PAST + 1][OFFPISTE_CONTROLS];
        for (int row = 0; row <= PAST; row++) {
            for (int k = 0; k < NUMBERS; k++)
                if (measured(k)) states[row][k] = buffer.at(names()[k])(first + row);
            for (int k = 0; k < OFFPISTE_CONTROLS; k++)
                controls[row][k] = k < 3 ? buffer.at("CONTROL_" + std::to_string(k))(first + row) : this->params_.gear;
        }
        const state_array state = start(states[PAST], states[0], controls[0]);
        for (int k = NUMBERS; k < STATE_DIM; k++) this->params_.memory[k] = state(k);
        this->params_.remembers = true;
        paramsToDevice();
        return true;
    }

    /* A state by the names of StateIndex, with what the networks remembered at the last updateFromBuffer; not a number
       where a name is missing, which plants do not plan from. */
    state_array stateFromMap(const std::map<std::string, float>& map) override {
        std::vector<std::string> wanted = keys();
        if (this->checkIfKeysInMap(map, wanted)) return state_array::Constant(NAN);
        state_array state = state_array::Zero();
        for (int k = 0; k < NUMBERS; k++)
            if (measured(k)) state(k) = map.at(names()[k]);
        for (int k = NUMBERS; k < STATE_DIM; k++) state(k) = this->params_.memory[k];
        return state;
    }

    /* One pedal: of throttle and brake, the smaller is taken off both; then the ranges of the controls. */
    void enforceConstraints(Eigen::Ref<state_array> state, Eigen::Ref<control_array> control) {
        one_pedal(control.data());
        PARENT_CLASS::enforceConstraints(state, control);
    }

    __device__ void enforceConstraints(float* state, float* control) {
        if (threadIdx.y == 0) one_pedal(control);
        __syncthreads();
        PARENT_CLASS::enforceConstraints(state, control);
    }

    __device__ void initializeDynamics(
        float* state, float* control, float* output, float* theta_s, float t_0, float dt) {
        const int thread = threadIdx.x + blockDim.x * (threadIdx.y + blockDim.y * threadIdx.z);
        const int threads = blockDim.x * blockDim.y * blockDim.z;
        const float* weights = (const float*)&this->params_.model;
        for (int k = thread; k < (int)(sizeof(offpiste_params) / sizeof(float)); k += threads) theta_s[k] = weights[k];
        if (threadIdx.y == 0) {
            for (int k = NUMBERS; k < STATE_DIM && this->params_.remembers; k++) state[k] = this->params_.memory[k];
            for (int k = 0; k < OUTPUT_DIM; k++) output[k] = state[k];
        }
    }

    void step(
        Eigen::Ref<state_array> state, Eigen::Ref<state_array> next_state, Eigen::Ref<state_array> state_der,
        const Eigen::Ref<const control_array>& control, Eigen::Ref<output_array> output, const float t,
        const float dt) {
        advance(&this->params_.model, state.data(), control.data(), next_state.data());
        for (int k = 0; k < STATE_DIM; k++) state_der(k) = (next_state(k) - state(k)) / 0.02f;
        for (int k = 0; k < OUTPUT_DIM; k++) output(k) = next_state(k);
    }

    /* The whole step in the threads with threadIdx.y == 0; a block of (64, 1, 1) keeps them all busy. */
    __device__ inline void step(
        float* state, float* next_state, float* state_der, float* control, float* output, float* theta_s,
        const float t, const float dt) {
        if (threadIdx.y == 0) {
            advance((const offpiste_params*)theta_s, state, control, next_state);
            for (int k = 0; k < OUTPUT_DIM; k++) output[k] = next_state[k];
        }
    }

protected:
    TwoDTextureHelper<float2>* slopes_ = nullptr;
    OffpisteCodes* codes_ = nullptr;

    static const char* const* names() {
        static const char* const all[] = {"POS_X",       "POS_Y",       "YAW",              "VEL_X", "VEL_Y", "OMEGA_Z",
                                          "BRAKE_STATE", "STEER_ANGLE", "STEER_ANGLE_RATE", "ENGINE_RPM"};
        return all;
    }

    static bool measured(int k) { return !(OFFPISTE_ABSENT >> k & 1); }

    static std::vector<std::string> keys() {
        std::vector<std::string> result;
        for (int k = 0; k < NUMBERS; k++)
            if (measured(k)) result.push_back(names()[k]);
        return result;
    }

    static __host__ __device__ void one_pedal(float* control) {
        const float pedal = control[0] - control[1];
        control[0] = pedal > 0.0f ? pedal : 0.0f;
        control[1] = pedal < 0.0f ? -pedal : 0.0f;
    }

    __host__ __device__ void advance(
        const offpiste_params* params, const float* state, const float* control, float* next_state) {
        offpiste_given given;
        float own[STATE_DIM]; /* in registers on the GPU */
        for (int k = 0; k < STATE_DIM; k++) own[k] = state[k];
        for (int k = 0; k < OFFPISTE_CONTROLS; k++) given.control[k] = k < 3 ? control[k] : this->params_.gear;
        look(own, &given);
        offpiste_step(params, &given, own);
        for (int k = 0; k < STATE_DIM; k++) next_state[k] = own[k];
    }

    /* The ground under the wheels of a state, as offpiste_look reads it, by textures. */
    __host__ __device__ void look(const float* state, offpiste_given* given) {
        const offpiste_grid* grid = &this->params_.grid;
        const float c = offpiste_cos(state[2]), s = offpiste_sin(state[2]);
        float normal[3] = {0.0f, 0.0f, 0.0f}, unknown = 0.0f;
        for (int k = 0; k < 4; k++) {
            const float* wheel = this->params_.wheels[k];
            const offpiste_cell_place place = offpiste_cell_at(
                grid, state[0] + c * wheel[0] - s * wheel[1], state[1] + s * wheel[0] + c * wheel[1]);
            const float3 at = make_float3((place.x + 0.5f) / grid->columns, (place.y + 0.5f) / grid->rows, 0.0f);
            float rise[2] = {0.0f, 0.0f};
            if (place.inside) {
                const float2 both = slopes_->queryTexture(0, at);
                rise[0] = both.x;
                rise[1] = both.y;
            }
            offpiste_add_tilt(rise, place.inside, normal, &unknown);
#if OFFPISTE_CODES
            for (int n = 0; n < OFFPISTE_TEXTURES; n++) {
                const float* kept = this->params_.missing + 4 * n;
                float4 four = make_float4(kept[0], kept[1], kept[2], kept[3]);
                if (place.inside) four = codes_->queryTexture(n, at);
                const float code[4] = {four.x, four.y, four.z, four.w};
                for (int m = 0; m < 4 && 4 * n + m < OFFPISTE_CODE; m++)
                    given->codes[OFFPISTE_CODE * k + 4 * n + m] = code[m];
            }
#endif
        }
        for (int k = 0; k < 3; k++) given->normal[k] = normal[k];
        given->unknown = unknown;
    }
};
