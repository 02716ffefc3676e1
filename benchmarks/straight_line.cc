// The arithmetic of one cylinder's step written out in a row: no structures, no guards, no
// parameters read at run time, no energy of the load, no sensors. Prints ns a step, the best of
// REPEATS runs, and the final x, v, pA, pB.
#include <chrono>
#include <cmath>
#include <cstdio>

int main() {
  constexpr int kSteps = 4000, kRepeats = 200;
  constexpr double h = 5e-4, dt = 0.5 * h, mass = 20.0, pi = 3.14159265358979323846;
  constexpr double atm = 101325.0, x0_air = 0.005, inv_n = 1.0 / 1.4, inv_beta = 1.0 / 1.4e9;
  constexpr double area_a = pi / 4 * 0.016 * 0.016, area_b = pi / 4 * (0.016 * 0.016 - 0.01 * 0.01);
  constexpr double va0 = 2.903e-6, vb0 = 1.676e-6, stroke = 0.08, ps = 16e6, cr = 1e10;
  constexpr double lap = 0.02, eps2 = 0.0216 * 0.0216, ci = 1.7e-13;
  constexpr double s0 = 2e6, s1 = 2e3, b = 700.0, fc = 100.0, fs = 150.0, inv_vs = 1.0 / 0.014;
  const double gain = 1.25e-4 / std::sqrt(3.5e6);
  const double w = 2 * pi * 250.0, z = 0.7, wd = w * std::sqrt(1 - z * z), e = std::exp(-z * w * dt);
  const double cc = std::cos(wd * dt), ss = std::sin(wd * dt) / wd;
  const double txx = e * (cc + z * w * ss), txv = e * ss, tvx = -e * w * w * ss, tvv = e * (cc - z * w * ss);
  const double g = 1 - 1 / std::sqrt(2.0), gdt = g * dt;
  double best = 1e9, x = 0, v = 0, pa = 0, pb = 0;
  for (int repeat = 0; repeat < kRepeats; ++repeat) {
    x = 0.04; v = 0; pa = 6e6 + atm; pb = 9.8e6 + atm;
    double xs = 0, vs = 0, bristle = 0, load = 0, before = 0, supply = 0, edges = 0, leak = 0;
    const auto liquid = [&](double p) { return (1 - x0_air) * std::exp((atm - p) * inv_beta); };
    const auto gas = [&](double p) { return x0_air * std::exp(-inv_n * std::log(p * (1 / atm))); };
    double na = (va0 + area_a * x) / (gas(pa) + liquid(pa));
    double nb = (vb0 + area_b * (stroke - x)) / (gas(pb) + liquid(pb));
    const auto start = std::chrono::steady_clock::now();
    for (int step = 0; step < kSteps; ++step) {
      const double u = 0.1 * std::sin(2 * pi * 2 * h * step);
      double vol_a = va0 + area_a * x, vol_b = vb0 + area_b * (stroke - x);
      // expansions about the pressures, one Halley step
      double la = liquid(pa), lb = liquid(pb), ga = gas(pa), gb = gas(pb);
      double wa = la + ga, wb = lb + gb;
      double sa = -la * inv_beta - ga * inv_n / pa, sb = -lb * inv_beta - gb * inv_n / pb;
      const double ca = ga * inv_n * (inv_n + 1) / (pa * pa) + la * inv_beta * inv_beta;
      const double cb = gb * inv_n * (inv_n + 1) / (pb * pb) + lb * inv_beta * inv_beta;
      const auto halley = [](double target, double w0, double slope, double curve) {
        const double inverse = 1 / slope, newton = (target - w0) * inverse;
        return newton / (1 + 0.5 * newton * (curve * inverse));
      };
      double da = halley(vol_a / na, wa, sa, ca), db = halley(vol_b / nb, wb, sb, cb);
      pa += da; sa += ca * da; wa = vol_a / na;
      pb += db; sb += cb * db; wb = vol_b / nb;
      // force
      const double r = v * inv_vs, level = fc + (fs - fc) * std::exp(-r * r);
      const double bristle_force = s0 * bristle;
      const double slope = b + s1 * (1 - std::copysign(1.0, v) * bristle_force / level);
      const double pressure = (pa - atm) * area_a - (pb - atm) * area_b;
      const double steady_load = load * before > 0 ? (std::abs(load) < std::abs(before) ? load : before) : 0;
      const double kk = h / mass * slope;
      const double between = v + 0.5 * (h / mass) * (pressure - bristle_force + steady_load - slope * v) / (1 + 0.5 * kk);
      const double force = pressure - bristle_force - slope * between;
      const double next = v + h * force / mass;
      // two sub-steps of ROS2
      double f_open = gain * 0.5 * (xs - lap + std::sqrt((xs - lap) * (xs - lap) + eps2));
      double b_open = gain * 0.5 * (-xs - lap + std::sqrt((xs + lap) * (xs + lap) + eps2));
      for (int i = 1; i <= 2; ++i) {
        const double ex = xs - u;
        xs = u + txx * ex + txv * vs;
        vs = tvx * ex + tvv * vs;
        const double f_end = gain * 0.5 * (xs - lap + std::sqrt((xs - lap) * (xs - lap) + eps2));
        const double b_end = gain * 0.5 * (-xs - lap + std::sqrt((xs + lap) * (xs + lap) + eps2));
        const double end_a = va0 + area_a * (x + next * (i * dt));
        const double end_b = vb0 + area_b * (stroke - (x + next * (i * dt)));
        double q[4], t[4], q2[4];
        const double dp[4] = {ps + atm - pa, pa - atm, ps + atm - pb, pb - atm};
        const double open[4] = {f_open, b_open, b_open, f_open};
        for (int k = 0; k < 4; ++k) {
          const double square = dp[k] * dp[k], sum = square + cr;
          const double scale = open[k] / std::sqrt(std::sqrt(sum));
          q[k] = scale * dp[k];
          t[k] = scale * (1 - 0.5 * square / sum);
        }
        const double lk = ci * (pa - pb), saa = -t[0] - t[1] - ci, sbb = -t[2] - t[3] - ci;
        const double ka = 1 / (sa * na), kb = 1 / (sb * nb);
        const double ra = ka * (end_a - vol_a), rb = kb * (end_b - vol_b);
        const double ia = na / vol_a, ib = nb / vol_b;
        const double maa = 1 + gdt * saa * ka, mbb = 1 + gdt * sbb * kb;
        const double mab = gdt * ci * kb, mba = gdt * ci * ka, det = 1 / (maa * mbb - mab * mba);
        const double fa = g * (saa * ra + ci * rb) * ia, fb = g * (sbb * rb + ci * ra) * ib;
        const double r1a = (q[0] - q[1] - lk) * ia + fa, r1b = (q[2] - q[3] + lk) * ib + fb;
        const double k1a = (mbb * r1a - mab * r1b) * det, k1b = (maa * r1b - mba * r1a) * det;
        const double na2 = na + dt * k1a, nb2 = nb + dt * k1b;
        const double pa2 = pa + halley(end_a / na2, wa, sa, ca), pb2 = pb + halley(end_b / nb2, wb, sb, cb);
        const double dp2[4] = {ps + atm - pa2, pa2 - atm, ps + atm - pb2, pb2 - atm};
        const double open2[4] = {f_end, b_end, b_end, f_end};
        for (int k = 0; k < 4; ++k) q2[k] = open2[k] / std::sqrt(std::sqrt(dp2[k] * dp2[k] + cr)) * dp2[k];
        const double lk2 = ci * (pa2 - pb2);
        const double r2a = (q2[0] - q2[1] - lk2) * na2 / end_a - 2 * k1a - fa;
        const double r2b = (q2[2] - q2[3] + lk2) * nb2 / end_b - 2 * k1b - fb;
        na += dt * (1.5 * k1a + 0.5 * (mbb * r2a - mab * r2b) * det);
        nb += dt * (1.5 * k1b + 0.5 * (maa * r2b - mba * r2a) * det);
        da = halley(end_a / na, wa, sa, ca); db = halley(end_b / nb, wb, sb, cb);
        pa += da; sa += ca * da; wa = end_a / na;
        pb += db; sb += cb * db; wb = end_b / nb;
        vol_a = end_a; vol_b = end_b; f_open = f_end; b_open = b_end;
        supply += 0.5 * dt * (q[0] + q[2] + q2[0] + q2[2]);
        for (int k = 0; k < 4; ++k) edges += 0.5 * dt * (q[k] * dp[k] + q2[k] * dp2[k]);
        leak += 0.5 * dt * (lk * (pa - pb) + lk2 * (pa2 - pb2));
      }
      // bristle and the load seen
      const double r2 = next * inv_vs, level2 = fc + (fs - fc) * std::exp(-r2 * r2);
      const double rest = std::copysign(level2 / s0, next);
      bristle = rest + (bristle - rest) * std::exp(-s0 * std::abs(next) / level2 * h);
      const double seen = mass * (next - v) / h - force;
      before = step ? load : seen;
      load = seen;
      v = next;
      x += h * v;
    }
    const std::chrono::duration<double, std::nano> spent = std::chrono::steady_clock::now() - start;
    best = std::fmin(best, spent.count() / kSteps + 0 * (supply + edges + leak));
    if (supply + edges + leak == 12345.0) std::puts("");  // keeps the sums alive
  }
  std::printf("%.6g %.17g %.17g %.17g %.17g\n", best, x, v, pa - atm, pb - atm);
}
