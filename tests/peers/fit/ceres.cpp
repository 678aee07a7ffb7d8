// Fits rho_d and isotropic lobes to the texels of a file with Ceres on one thread and writes the coefficients.
//
// ceres IN OUT LOBES: IN holds int32 texels, int32 samples, then for each texel float64 plane[samples], zz[samples],
// rgb[samples][3]. OUT gets float64 seconds of CPU time, then for each texel rho_d[3] and for each lobe albedo[3], angle, ln n.
#include <ceres/ceres.h>
#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <vector>

namespace {

struct Texel {
    std::vector<double> plane, zz, rgb;
};

// f = rho_d + sum albedo * base^n, base = sqrt(3/2) sin(angle) plane + sqrt(3) cos(angle) zz, with the analytic Jacobian.
class Residuals : public ceres::CostFunction {
public:
    Residuals(const Texel& texel, int lobes) : texel_(texel), lobes_(lobes) {
        mutable_parameter_block_sizes()->push_back(3 + 5 * lobes);
        set_num_residuals(static_cast<int>(texel.rgb.size()));
    }

    bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
        const double* x = parameters[0];
        const int size = 3 + 5 * lobes_;
        double* jacobian = jacobians ? jacobians[0] : nullptr;
        if (jacobian) std::fill(jacobian, jacobian + size * texel_.rgb.size(), 0.0);
        for (std::size_t k = 0; k < texel_.plane.size(); ++k) {
            double* r = residuals + 3 * k;
            for (int c = 0; c < 3; ++c) {
                r[c] = x[c] - texel_.rgb[3 * k + c];
                if (jacobian) jacobian[(3 * k + c) * size + c] = 1.0;
            }
            for (int j = 0; j < lobes_; ++j) {
                const double* lobe = x + 3 + 5 * j;
                const double across = std::sqrt(1.5) * texel_.plane[k], along = std::sqrt(3.0) * texel_.zz[k];
                const double s = std::sin(lobe[3]), z = std::cos(lobe[3]), n = std::exp(lobe[4]);
                const double base = s * across + z * along;
                if (base <= 1e-12) continue;
                const double log = std::log(base), shape = std::exp(n * log);
                for (int c = 0; c < 3; ++c) {
                    r[c] += lobe[c] * shape;
                    if (!jacobian) continue;
                    double* row = jacobian + (3 * k + c) * size + 3 + 5 * j;
                    row[c] = shape;
                    row[3] = lobe[c] * shape * n / base * (z * across - s * along);
                    row[4] = lobe[c] * shape * n * log;
                }
            }
        }
        // A step into overflow is refused, as Ceres has it.
        return std::all_of(residuals, residuals + texel_.rgb.size(), [](double r) { return std::isfinite(r); });
    }

private:
    const Texel& texel_;
    int lobes_;
};

}  // namespace

int main(int argc, char** argv) {
    if (argc != 4) return 2;
    google::InitGoogleLogging(argv[0]);
    FLAGS_minloglevel = 3;
    const int lobes = std::atoi(argv[3]);
    std::FILE* in = std::fopen(argv[1], "rb");
    std::int32_t header[2];
    if (!in || std::fread(header, sizeof header, 1, in) != 1) return 2;
    std::vector<Texel> texels(header[0]);
    const std::size_t samples = header[1];
    for (Texel& texel : texels) {
        for (auto* list : {&texel.plane, &texel.zz, &texel.rgb}) {
            list->resize(list == &texel.rgb ? 3 * samples : samples);
            if (std::fread(list->data(), sizeof(double), list->size(), in) != list->size()) return 2;
        }
    }
    std::fclose(in);
    const int size = 3 + 5 * lobes;
    std::vector<double> found(texels.size() * size);
    const std::clock_t start = std::clock();
    for (std::size_t t = 0; t < texels.size(); ++t) {
        double* x = &found[t * size];
        // The start of the source: Phong's lobe with n = 10, then a retro-reflective one with n = 5.
        for (int c = 0; c < 3; ++c) x[c] = 0.05;
        for (int j = 0; j < lobes; ++j) {
            double* lobe = x + 3 + 5 * j;
            for (int c = 0; c < 3; ++c) lobe[c] = 0.1;
            lobe[3] = j == 0 ? std::atan2(-M_SQRT2, 1.0) : std::atan2(M_SQRT2, 1.0);
            lobe[4] = std::log(j == 0 ? 10.0 : 5.0);
        }
        ceres::Problem problem;
        problem.AddResidualBlock(new Residuals(texels[t], lobes), nullptr, x);
        for (int i = 0; i < size; ++i) {
            const int place = i < 3 ? i : (i - 3) % 5;
            if (place < 3) problem.SetParameterLowerBound(x, i, 0.0);
            if (i >= 3 && place == 4) {
                problem.SetParameterLowerBound(x, i, std::log(0.5));
                problem.SetParameterUpperBound(x, i, std::log(20000.0));
            }
        }
        ceres::Solver::Options options;
        options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
        options.num_threads = 1;
        options.max_num_iterations = 100;
        options.logging_type = ceres::SILENT;
        ceres::Solver::Summary summary;
        ceres::Solve(options, &problem, &summary);
    }
    const double seconds = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
    std::FILE* out = std::fopen(argv[2], "wb");
    if (!out || std::fwrite(&seconds, sizeof seconds, 1, out) != 1) return 1;
    if (std::fwrite(found.data(), sizeof(double), found.size(), out) != found.size()) return 1;
    return std::fclose(out);
}
