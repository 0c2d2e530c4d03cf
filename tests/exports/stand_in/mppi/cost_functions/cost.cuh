/* Costs of MPPI-Generic. */
#pragma once
#include <mppi/dynamics/dynamics.cuh>

template <int N>
struct CostParams {};

template <class CLASS_T, class PARAMS_T, class DYN_PARAMS_T>
class Cost : public Managed {
public:
    using output_array = Eigen::Matrix<float, (int)DYN_PARAMS_T::OutputIndex::NUM_OUTPUTS, 1>;
    virtual ~Cost() {}
    virtual std::string getCostFunctionName() const { return ""; }
    void setParams(const PARAMS_T& params) { params_ = params; }

protected:
    PARAMS_T params_;
};
