// A control loop with an exported compensator: loop COMPENSATOR.pt [SAMPLES]
// Prints the desired displacement and the voltage of each tick, and at last, on the error stream, the median
// and the 99.9th percentile of a step's time. In place of printf stands the converter.

#include <ATen/Parallel.h>
#include <torch/script.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numbers>
#include <vector>

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "loop: want COMPENSATOR.pt [SAMPLES]\n");
    return 2;
  }
  try {
    at::set_num_threads(1);  // a step has nothing to share out
    torch::jit::Module compensator = torch::jit::load(argv[1]);
    const int samples = argc > 2 ? std::atoi(argv[2]) : 20;
    const double period = compensator.attr("sample_period_s").toDouble();
    const auto preview = compensator.attr("preview").toInt();
    const torch::jit::Method step = compensator.get_method("step");
    torch::InferenceMode no_gradients;

    // The motion that is wanted, known ahead: a 5 Hz sine, 0 ... 4 um.
    const auto desired_um = [period](long tick) {
      return 2 - 2 * std::cos(2 * std::numbers::pi * 5 * tick * period);
    };

    for (int i = 0; i < 20; ++i) step({0.0});  // warm up
    compensator.get_method("reset")({});

    std::vector<double> times_us;
    for (long tick = 0; tick < samples; ++tick) {
      const double yd = desired_um(tick + preview);
      const auto start = std::chrono::steady_clock::now();
      const double voltage = step({yd}).toDouble();
      times_us.push_back(std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start).count());
      std::printf("%.6f s  %.6f um  %.17g V\n", tick * period, desired_um(tick), voltage);
    }
    std::sort(times_us.begin(), times_us.end());
    if (samples > 0) {
      std::fprintf(stderr, "%d steps, median %.3f us, 99.9 %% below %.3f us\n", samples, times_us[samples / 2],
                   times_us[samples * 999L / 1000]);
    }
  } catch (const c10::Error& error) {
    std::fprintf(stderr, "loop: %s is not an exported compensator\n", argv[1]);
    return 2;
  }
}
