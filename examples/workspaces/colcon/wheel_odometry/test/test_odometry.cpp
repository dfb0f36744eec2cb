#include <gtest/gtest.h>

#include <csignal>
#include <cstdlib>

#include "wheel_odometry.hpp"

TEST(Odometry, OneTurnIsTheCircumference) { EXPECT_DOUBLE_EQ(wheel_odometry::rolled(512, 512, 0.5), 0.5); }

TEST(Odometry, BackwardsIsNegative) {
  const double expected = std::getenv("FAILS") ? 0.25 : -0.25;  // the README plants this failure
  EXPECT_DOUBLE_EQ(wheel_odometry::rolled(-256, 512, 0.5), expected);
}

TEST(Odometry, NoCrash) {
  if (std::getenv("CRASHES")) {
    std::raise(SIGSEGV);
  }
}
