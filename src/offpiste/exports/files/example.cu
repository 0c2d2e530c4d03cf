/* The same on a GPU, a drive a thread: weights in shared memory, the state in registers.

       nvcc -std=c++17 -O3 -arch=native example.cu -o example && ./example parity.bin */
#include "offpiste.h"
#include "kernels.h"
#include "parity.h"

__global__ void __launch_bounds__(OFFPISTE_BLOCK) roll_out(
    const offpiste_params* weights, offpiste_map map, const float* starts, const float* controls, float* states,
    int steps, int n) {
    OFFPISTE_SHARED_PARAMS(params, weights)
    OFFPISTE_EACH(i, n);
    float state[OFFPISTE_STATE];
    offpiste_given given;
    OFFPISTE_UNROLL
    for (int k = 0; k < OFFPISTE_STATE; k++) state[k] = starts[OFFPISTE_STATE * i + k];
    for (int t = 0; t < steps; t++) {
        OFFPISTE_FORGET
        OFFPISTE_UNROLL
        for (int k = 0; k < OFFPISTE_CONTROLS; k++) given.control[k] = controls[OFFPISTE_CONTROLS * (i * steps + t) + k];
        offpiste_look(&map, state, &given);
        offpiste_step(params, &given, state);
        OFFPISTE_UNROLL
        for (int k = 0; k < 10; k++) states[10 * (i * steps + t) + k] = state[k];
    }
}

static void check(cudaError_t error) {
    if (error != cudaSuccess) {
        fprintf(stderr, "CUDA: %s\n", cudaGetErrorString(error));
        exit(1);
    }
}

static void* on_device(const void* data, size_t bytes) {
    void* copy;
    check(cudaMalloc(&copy, bytes));
    check(cudaMemcpy(copy, data, bytes, cudaMemcpyHostToDevice));
    return copy;
}

int main(int count, char** arguments) {
    const offpiste_parity p = offpiste_read_parity(count > 1 ? arguments[1] : "parity.bin");
    const size_t cells = (size_t)p.rows * p.columns, out = sizeof(float) * 10 * p.drives * p.steps;
    float* codes = offpiste_code_cells(&p);
    const offpiste_map map = offpiste_map_of(&p, codes);
    float* starts = (float*)malloc(sizeof(float) * OFFPISTE_STATE * p.drives);
    float* states = (float*)malloc(out);
    if (!starts || !states) return 1;
    for (int drive = 0; drive < p.drives; drive++) offpiste_start_of(&p, &map, drive, starts + OFFPISTE_STATE * drive);

    const size_t code = sizeof(float) * (OFFPISTE_CODES / 4);
    offpiste_map there = map;
    there.slope = (const float*)on_device(map.slope, sizeof(float) * 2 * cells);
    there.codes = (const float*)on_device(codes, code * cells + sizeof(float));
    there.missing = (const float*)on_device(map.missing, code + sizeof(float));
    const offpiste_params* weights = (const offpiste_params*)on_device(&offpiste_model, sizeof offpiste_model);
    const float* begin = (const float*)on_device(starts, sizeof(float) * OFFPISTE_STATE * p.drives);
    const float* controls = (const float*)on_device(p.control, sizeof(float) * p.controls * p.drives * p.steps);
    float* found = (float*)on_device(states, out);
    const int blocks = (p.drives + OFFPISTE_BLOCK - 1) / OFFPISTE_BLOCK;
    roll_out<<<blocks, OFFPISTE_BLOCK>>>(weights, there, begin, controls, found, p.steps, p.drives);
    check(cudaGetLastError());
    check(cudaMemcpy(states, found, out, cudaMemcpyDeviceToHost));
    const int failed = offpiste_report(&p, states);
    free(starts), free(states), free(codes), free(p.content);
    return failed;
}
