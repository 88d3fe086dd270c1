// A control loop with an exported compensator: loop COMPENSATOR.pt [SAMPLES]
// Prints the desired displacement and the voltage of each tick. In place of printf stands the converter.

#include <torch/script.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numbers>

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "loop: want COMPENSATOR.pt [SAMPLES]\n");
    return 2;
  }
  try {
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

    for (long tick = 0; tick < samples; ++tick) {
      const double voltage = step({desired_um(tick + preview)}).toDouble();
      std::printf("%.6f s  %.6f um  %.17g V\n", tick * period, desired_um(tick), voltage);
    }
  } catch (const c10::Error& error) {
    std::fprintf(stderr, "loop: %s is not an exported compensator\n", argv[1]);
    return 2;
  }
}
