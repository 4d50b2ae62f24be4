// Channels that are at an end of the camera's range.
#include "../../common.h"

enum { PIECE = 192 };  // values looked at together: nearly everywhere none is clipped

// Marks channel c where it is at most `dark_to` and low[c], or at least `saturated_from` and high[c]. Returns the number of marks;
// without any, nothing is written.
EXPORT int clipped_channels(const uint8_t *image, const bool *low, const bool *high, uint8_t *clipped, int32_t dark_to,
                            int32_t saturated_from, ptrdiff_t h, ptrdiff_t w) {
  const uint8_t dark = (uint8_t)dark_to, saturated = (uint8_t)saturated_from;
  int found = 0;
  for (ptrdiff_t start = 0; start < 3 * h * w; start += PIECE) {
    const ptrdiff_t n = 3 * h * w - start < PIECE ? 3 * h * w - start : PIECE;
    uint8_t least = 255, most = 0;
    for (ptrdiff_t i = start; i < start + n; i++) least = image[i] < least ? image[i] : least, most = image[i] > most ? image[i] : most;
    if (least > dark && most < saturated) continue;
    for (ptrdiff_t i = start; i < start + n; i++) {
      if (!((image[i] <= dark && low[i % 3]) || (image[i] >= saturated && high[i % 3]))) continue;
      if (found++ == 0) memset(clipped, 0, (size_t)(3 * h * w));
      clipped[i] = 1;
    }
  }
  return found;
}
