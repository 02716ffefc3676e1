// Steady valve map of one joint: command for a position and speed, and speed for a command.
#pragma once

namespace leglab::feedforward {

// Bilinear interpolation in a table with strictly monotone rows, so that `command` and `share` are
// exact inverses of each other; beyond the ends of a row it extrapolates linearly.
struct ValveTable {
  int rows = 0, columns = 0;
  double start = 0.0, spacing = 1.0;  // of the rows' positions [rad]
  const double* speed = nullptr;      // of each column, increasing, as a share of full speed
  const double* commands = nullptr;   // rows times columns

  double command(double position, double share) const {
    const Row row = at(position);
    int j = columns / 2;
    while (j > 1 && share < speed[j - 1]) --j;
    while (j < columns - 1 && share > speed[j]) ++j;
    return between(share, speed[j - 1], speed[j], value(row, j - 1), value(row, j));
  }

  // Speed, as a share of full speed, that the valve gives at a command.
  double share(double position, double command) const {
    const Row row = at(position);
    const bool rising = value(row, columns - 1) > value(row, 0);
    int j = columns / 2;
    double low = value(row, j - 1), high = value(row, j);
    while (j > 1 && (rising ? command < low : command > low)) {
      high = low;
      low = value(row, --j - 1);
    }
    while (j < columns - 1 && (rising ? command > high : command < high)) {
      low = high;
      high = value(row, ++j);
    }
    return between(command, low, high, speed[j - 1], speed[j]);
  }

 private:
  struct Row {
    const double* first;
    double part;  // share of the way from this row to the next
  };

  Row at(double position) const {
    double place = (position - start) / spacing;
    const double last = rows - 1;
    if (!(place > 0.0)) place = 0.0;  // also for NaN
    if (place > last) place = last;
    int row = static_cast<int>(place);
    if (row > rows - 2) row = rows - 2;
    return {commands + row * columns, place - row};
  }

  double value(const Row& row, int j) const {
    return row.first[j] + row.part * (row.first[j + columns] - row.first[j]);
  }

  static double between(double x, double x0, double x1, double y0, double y1) {
    return y0 + (x - x0) / (x1 - x0) * (y1 - y0);
  }
};

}  // namespace leglab::feedforward
