#pragma once

namespace wheel_odometry {

/// Path of a wheel, in metres, whose encoder counts ticks; negative if it has turned backwards.
inline double rolled(long ticks, long ticks_per_turn, double circumference) {
  if (ticks_per_turn <= 0) {
    return 0.0;
  }
  return circumference * static_cast<double>(ticks) / static_cast<double>(ticks_per_turn);
}

}  // namespace wheel_odometry
