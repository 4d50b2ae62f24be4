// The entropy-coded part of a sequential JPEG, read as a decoder reads it but without making pixels: whether it is whole.
// A decoder that meets damage there fills the picture up and goes on (ITU-T T.81, annex F.2).
#include "../common.h"

enum { WHOLE, BAD_CODE, BAD_LEVEL, ENDED_EARLY, BYTES_LEFT, NO_RESTART };  // what jpeg_scan returns
enum { TABLES = 8, LONGEST = 16, LOOK = 9 };  // 4 for levels of blocks, 4 for what varies in them
enum { MOST_BLOCKS = 10 };                      // of an MCU
enum { RANGE = 1024 };                          // largest coefficient of 8-bit samples, either sign

struct code {
  uint8_t length[1 << LOOK], symbol[1 << LOOK];  // by the next LOOK bits; length 0: it is longer
  int32_t beyond[LONGEST + 2];                   // first code of each length that is none, -1: no code is so long
  int32_t offset[LONGEST + 2];                   // from a code of each length to its place among the symbols
  const uint8_t *symbols;
};

struct bits {
  const uint8_t *bytes;
  ptrdiff_t at, n;
  uint64_t held;  // its lowest `count` bits are next
  int count;
};

// Canonical codes, in the order of their lengths; false where there are more than fit.
static bool build(struct code *code, const uint8_t *counts, const uint8_t *symbols) {
  memset(code->length, 0, sizeof code->length);
  code->symbols = symbols;
  int32_t next = 0, place = 0;
  for (int length = 1; length <= LONGEST; length++, next <<= 1) {
    code->offset[length] = place - next;
    if (next + counts[length - 1] > 1 << length || place + counts[length - 1] > 256) return false;
    for (int k = 0; k < counts[length - 1]; k++, next++, place++)
      for (int rest = 0; length <= LOOK && rest < 1 << (LOOK - length); rest++) {
        code->length[next << (LOOK - length) | rest] = (uint8_t)length;
        code->symbol[next << (LOOK - length) | rest] = symbols[place];
      }
    code->beyond[length] = counts[length - 1] ? next : -1;
  }
  return true;
}

// Bytes up to a marker; a byte 255 of the data is followed by 0.
static void fill(struct bits *bits) {
  while (bits->count <= 56 && bits->at < bits->n) {
    const uint8_t byte = bits->bytes[bits->at];
    if (byte == 255 && (bits->at + 1 >= bits->n || bits->bytes[bits->at + 1] != 0)) return;
    bits->at += byte == 255 ? 2 : 1;
    bits->held = bits->held << 8 | byte;
    bits->count += 8;
  }
}

// The next symbol, or minus what is wrong.
static int next_symbol(struct bits *bits, const struct code *code) {
  if (bits->count < LONGEST) fill(bits);
  const int seen = bits->count < LONGEST ? bits->count : LONGEST;
  const uint32_t ahead = (uint32_t)(bits->held << (LONGEST - seen) >> (bits->count - seen)) & 0xFFFF;
  int length = code->length[ahead >> (LONGEST - LOOK)], symbol = code->symbol[ahead >> (LONGEST - LOOK)];
  if (length == 0) {
    for (length = LOOK + 1; length <= LONGEST; length++)
      if ((int32_t)(ahead >> (LONGEST - length)) < code->beyond[length]) break;
    if (length > LONGEST) return seen < LONGEST ? -ENDED_EARLY : -BAD_CODE;
    symbol = code->symbols[(int32_t)(ahead >> (LONGEST - length)) + code->offset[length]];
  }
  if (length > bits->count) return -ENDED_EARLY;
  bits->count -= length;
  return symbol;
}

// A number of `size` bits: the lower half stands for negative ones.
static int32_t number(struct bits *bits, int size) {
  if (size == 0) return 0;
  const int32_t value = (int32_t)(bits->held >> (bits->count - size) & ((1u << size) - 1));
  bits->count -= size;
  return value < 1 << (size - 1) ? value - (1 << size) + 1 : value;
}

// One number, added to `level`, which times its step has to be one of 8-bit samples; WHOLE or what is wrong.
static int read_number(struct bits *bits, int size, int32_t step, int32_t *level) {
  if (size > 11) return BAD_CODE;
  if (bits->count < size) fill(bits);
  if (bits->count < size) return ENDED_EARLY;
  *level += number(bits, size);
  const int32_t coefficient = *level * step;
  return coefficient > RANGE + step || coefficient < -RANGE - step ? BAD_LEVEL : WHOLE;
}

static int read_block(struct bits *bits, const struct code *levels, const struct code *others, const uint16_t *steps,
                      int32_t *level) {
  int size = next_symbol(bits, levels);
  int wrong = size < 0 ? -size : read_number(bits, size, steps[0], level);
  for (int k = 1; k < 64 && wrong == WHOLE; k++) {
    const int symbol = next_symbol(bits, others);
    if (symbol < 0) return -symbol;
    if (symbol == 0) return WHOLE;
    k += symbol >> 4;
    size = symbol & 15;
    if (k > 63 || (size == 0 && symbol != 0xF0)) return BAD_CODE;
    int32_t other = 0;
    wrong = read_number(bits, size, steps[k], &other);
  }
  return wrong;
}

// To the restart marker that has to come here; what is held of the last byte are fill bits.
static int pass_restart(struct bits *bits, ptrdiff_t restart) {
  fill(bits);
  if (bits->count >= 8) return BYTES_LEFT;
  while (bits->at + 1 < bits->n && bits->bytes[bits->at + 1] == 255) bits->at++;
  if (bits->at + 1 >= bits->n || bits->bytes[bits->at + 1] != 0xD0 + restart % 8) return NO_RESTART;
  bits->at += 2;
  bits->count = 0;
  bits->held = 0;
  return WHOLE;
}

// `blocks`: of each block of an MCU its component, and its tables for levels and for the others. `steps`: of each
// component the quantisation, in the order of the file. `place`: MCUs that were read, and bytes up to the next marker.
EXPORT int jpeg_scan(const uint8_t *scan, const uint8_t *counts, const uint8_t *symbols, const uint8_t *blocks,
                     const uint16_t *steps, int64_t *place, int64_t mcus, int64_t interval, ptrdiff_t n, ptrdiff_t b) {
  struct code codes[TABLES];
  int32_t levels[4] = {0};
  struct bits bits = {scan, 0, n, 0, 0};
  place[0] = place[1] = 0;
  if (b > MOST_BLOCKS) return WRONG_SIZE;
  for (int k = 0; k < TABLES; k++)
    if (!build(&codes[k], counts + LONGEST * k, symbols + 256 * k)) return BAD_CODE;
  for (; place[0] < mcus; place[0]++) {
    int wrong = WHOLE;
    if (interval > 0 && place[0] > 0 && place[0] % interval == 0) {
      wrong = pass_restart(&bits, (ptrdiff_t)(place[0] / interval - 1));
      memset(levels, 0, sizeof levels);
    }
    for (ptrdiff_t k = 0; k < b && wrong == WHOLE; k++) {
      const uint8_t *block = blocks + 3 * k;
      wrong = read_block(&bits, &codes[block[1] & 3], &codes[4 + (block[2] & 3)], steps + 64 * (block[0] & 3), &levels[block[0] & 3]);
    }
    if (wrong != WHOLE) return wrong;
  }
  fill(&bits);
  place[1] = bits.at;
  return bits.count >= 8 ? BYTES_LEFT : WHOLE;
}
