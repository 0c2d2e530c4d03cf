/* Textures of MPPI-Generic, their queries on the host: normalised coordinates, clamped, linear or of the nearest cell. */
#pragma once
#include <mppi/dynamics/dynamics.cuh>

static inline float2 mixed(float2 a, float2 b, float u) { return {a.x * (1 - u) + b.x * u, a.y * (1 - u) + b.y * u}; }
static inline float4 mixed(float4 a, float4, float) { return a; }

enum { cudaFilterModePoint, cudaFilterModeLinear };

template <class T>
class TwoDTextureHelper : public Managed {
public:
    TwoDTextureHelper(int number, cudaStream_t) : textures_buffer_(number), values_(number), extents_(number) {}
    void GPUSetup() {}
    void freeCudaMem() {}
    void copyToDevice() {}
    void updateTexture(int index, std::vector<T>& values, cudaExtent& extent) {
        values_[index] = values;
        extents_[index] = extent;
    }
    T queryTexture(int index, const float3& at) {
        const int w = (int)extents_[index].width, h = (int)extents_[index].height;
        const float x = fminf(fmaxf(at.x * w - 0.5f, 0), w - 1), y = fminf(fmaxf(at.y * h - 0.5f, 0), h - 1);
        const std::vector<T>& values = values_[index];
        if (textures_buffer_[index].texDesc.filterMode == cudaFilterModePoint)
            return values[(int)std::round(y) * w + (int)std::round(x)];
        const int i = std::min((int)x, w - 2), j = std::min((int)y, h - 2);
        const T* corner = &values[j * w + i];
        return mixed(mixed(corner[0], corner[1], x - i), mixed(corner[w], corner[w + 1], x - i), y - j);
    }
    TwoDTextureHelper* ptr_d_ = nullptr;

protected:
    struct Texture {
        struct { int filterMode = cudaFilterModeLinear; } texDesc;
        bool update_mem = false;
    };
    std::vector<Texture> textures_buffer_;

private:
    std::vector<std::vector<T>> values_;
    std::vector<cudaExtent> extents_;
};
