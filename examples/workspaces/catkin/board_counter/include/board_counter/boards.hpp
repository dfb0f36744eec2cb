#pragma once

namespace board_counter {

/// Number of boards for a number of cameras that two boards at a time can see.
inline int boards_for(int cameras) { return cameras <= 0 ? 0 : (cameras + 1) / 2; }

}  // namespace board_counter
