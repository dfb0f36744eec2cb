#include <gtest/gtest.h>

#include <cstdlib>

#include "board_counter/boards.hpp"

TEST(Boards, OneForTwoCameras) { EXPECT_EQ(board_counter::boards_for(2), std::getenv("FAILS") ? 2 : 1); }

TEST(Boards, NoneWithoutCameras) { EXPECT_EQ(board_counter::boards_for(0), 0); }

int main(int count, char** arguments) {
  testing::InitGoogleTest(&count, arguments);
  return RUN_ALL_TESTS();
}
