/* Contrast of a picture: the image less its opening by a square, which is the greatest of the
 * least values about each pixel. OpenCV's takes as many steps a pixel as its square is wide, this
 * one the logarithm of it.
 *
 * A large picture is searched where a block of pixels may exceed the lowest level: its greatest
 * value less the opening of the blocks' least values, which is at most that of the pixels.
 */
#include "verify/measurement/detection/kernels/contrast.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/kernels/alignment.h"

#define BLOCK 16      /* px, side of a block */
#define MAX_BOXES 64  /* boxes that are searched one by one; with more, as one */
#define MAX_SHARE 0.4 /* of a picture, that these boxes and what is about them may cover */

static int64_t inside(int64_t bound, int64_t size)
{
    return MIN(MAX(bound, 0), size);
}

Box widen(Box box, int64_t margin, Grid picture)
{
    return (Box){
        inside(box.left - margin, picture.width),
        inside(box.top - margin, picture.height),
        inside(box.right + margin, picture.width),
        inside(box.bottom + margin, picture.height),
    };
}

/* Copy rows of so many values, which begin a pitch apart; those without a gap as one. */
static void copy_rows(int64_t rows, int64_t width, const uint8_t *values, int64_t pitch,
                      uint8_t *copied, int64_t copied_pitch)
{
    if (pitch == width && copied_pitch == width) {
        width *= rows;
        rows = 1;
    }
    for (int64_t y = 0; y < rows; y++)
        memcpy(copied + y * copied_pitch, values + y * pitch, (size_t)width);
}

Grid cut_out(Grid picture, Box box)
{
    int64_t height = box.bottom - box.top, width = box.right - box.left;
    uint8_t *values = TAKE(uint8_t, height * width);
    copy_rows(height, width, picture.values + box.top * picture.width + box.left, picture.width,
              values, width);
    return (Grid){values, height, width};
}

Grid enclose(Grid picture, int64_t above, int64_t beside)
{
    int64_t height = picture.height + 2 * above, width = picture.width + 2 * beside;
    uint8_t *values = TAKE(uint8_t, height * width);
    memset(values, 255, (size_t)(height * width));
    copy_rows(picture.height, picture.width, picture.values, picture.width,
              values + above * width + beside, width);
    return (Grid){values, height, width};
}

/* A picture less another one, scratch. */
static Grid difference(Grid picture, Grid other)
{
    int64_t size = picture.height * picture.width;
    uint8_t *values = TAKE(uint8_t, size);
    for (int64_t i = 0; i < size; i++)
        values[i] = picture.values[i] - other.values[i];
    return (Grid){values, picture.height, picture.width};
}

/* 255 less each value of a picture, scratch. */
static Grid negative(Grid picture)
{
    int64_t size = picture.height * picture.width;
    uint8_t *values = TAKE(uint8_t, size);
    for (int64_t i = 0; i < size; i++)
        values[i] = 255 - picture.values[i];
    return (Grid){values, picture.height, picture.width};
}

/* Fill in the lesser of two values each, (n,). */
static void least_of(int64_t n, const uint8_t *restrict values, const uint8_t *restrict others,
                     uint8_t *restrict least)
{
    #pragma omp simd
    for (int64_t i = 0; i < n; i++)
        least[i] = MIN(values[i], others[i]);
}

/* Least value in each square of 2 reach + 1 px, scratch; nothing is beyond the borders. */
static Grid erode(Grid picture, int64_t reach)
{
    int64_t height = picture.height, width = picture.width;
    for (int axis = 0; axis < 2; axis++) { /* along rows, which one border separates; down columns */
        int64_t pitch = axis == 0 ? width + reach : width, step = axis == 0 ? 1 : width, turn = 0;
        int64_t n = height * pitch + 2 * reach * step;
        uint8_t *room[2] = {TAKE(uint8_t, n), TAKE(uint8_t, n)}, *least = room[1];
        memset(least, 255, (size_t)n);
        copy_rows(height, width, picture.values, width, least + reach * step, pitch);
        for (int64_t have = 1, side = 2 * reach + 1, more; have < side; have += more, turn++) {
            more = MIN(have, side - have);
            n -= more * step; /* beyond it too few are ahead */
            least_of(n, least, least + more * step, room[turn % 2]);
            least = room[turn % 2];
        }
        if (axis == 0) {
            uint8_t *values = TAKE(uint8_t, height * width);
            copy_rows(height, width, least, pitch, values, width);
            least = values;
        }
        picture.values = least;
    }
    return picture;
}

/* Greatest of the least values, scratch. */
static Grid open_by(Grid picture, int64_t reach)
{
    return negative(erode(negative(erode(picture, reach)), reach));
}

Grid top_hat(Grid image, Box window, int64_t margin, int64_t reach)
{
    Box about = widen(window, MIN(margin, 2 * reach), image);
    Grid part = cut_out(image, about), contrast = difference(part, open_by(part, reach));
    return cut_out(contrast, (Box){window.left - about.left, window.top - about.top,
                                   window.right - about.left, window.bottom - about.top});
}

/* Whether a pixel is above a level, and not labelled yet. */
static bool is_new(Grid picture, int64_t level, int64_t place, const int32_t *label, int32_t number)
{
    return picture.values[place] > level && label[place] != number;
}

Box flood_fill(Grid picture, int64_t level, int64_t place, bool corners, int32_t *label,
               int32_t number)
{
    Mark mark = scratch_mark();
    int64_t height = picture.height, width = picture.width, waiting = 1;
    int32_t *stack = TAKE(int32_t, height * width);
    Box box = {width, height, 0, 0};
    stack[0] = (int32_t)place;
    label[place] = number;
    while (waiting > 0) {
        int64_t at = stack[--waiting], west = at, east = at + 1, y = at / width, row = y * width;
        while (west > row && is_new(picture, level, west - 1, label, number))
            label[--west] = number;
        while (east < row + width && is_new(picture, level, east, label, number))
            label[east++] = number;
        west -= row;
        east -= row;
        box = (Box){MIN(box.left, west), MIN(box.top, y), MAX(box.right, east),
                    MAX(box.bottom, y + 1)};
        for (int64_t v = y - 1; v < y + 2; v += 2) { /* its own row has no more of them */
            if (v < 0 || v >= height)
                continue;
            bool run = false; /* of new pixels: its first one stands for it */
            for (int64_t u = MAX(west - corners, 0); u < MIN(east + corners, width); u++) {
                bool starts = !run;
                run = is_new(picture, level, v * width + u, label, number);
                if (run && starts) {
                    label[v * width + u] = number;
                    stack[waiting++] = (int32_t)(v * width + u);
                }
            }
        }
    }
    scratch_release(mark);
    return box;
}

/* Greatest value in each of an image's blocks, scratch. */
static Grid greatest_in_blocks(Grid image)
{
    int64_t height = (image.height + BLOCK - 1) / BLOCK, width = (image.width + BLOCK - 1) / BLOCK;
    uint8_t *most = TAKE(uint8_t, height * width), *above = TAKE(uint8_t, width * BLOCK);
    for (int64_t row = 0; row < height; row++) {
        memset(above, 0, (size_t)(width * BLOCK));
        for (int64_t y = row * BLOCK; y < MIN((row + 1) * BLOCK, image.height); y++)
            for (int64_t x = 0; x < image.width; x++)
                above[x] = MAX(above[x], image.values[y * image.width + x]);
        for (int64_t column = 0; column < width; column++)
            most[row * width + column] = greatest(BLOCK, above + column * BLOCK);
    }
    return (Grid){most, height, width};
}

/* Fill in the box, px, of an image's blocks, and BOX_MARGIN about it. */
static void to_pixels(Box blocks, Grid image, double *row)
{
    Box box = {BLOCK * blocks.left, BLOCK * blocks.top, BLOCK * blocks.right,
               BLOCK * blocks.bottom};
    box = widen(box, BOX_MARGIN, image);
    row[0] = (double)box.left;
    row[1] = (double)box.top;
    row[2] = (double)box.right;
    row[3] = (double)box.bottom;
}

/* Fill in boxes (n, 4), disjoint, outside which no pixel's contrast exceeds a level, DN; give n, at
 * most MAX_BOXES.
 *
 * `reach` as for `top_hat`. Columns: x0, y0, x1, y1, px, upper bounds exclusive. A box includes
 * what is within BOX_MARGIN of such pixels. The whole picture is the one box where they would be
 * many or large. */
static int64_t contrast_boxes(Grid image, int64_t reach, int64_t level, int64_t *boxes)
{
    double apart[4 * (MAX_BOXES + 1)], area = 0.0;
    Grid most = greatest_in_blocks(image), least = negative(greatest_in_blocks(negative(image)));
    Grid contrast = difference(most, open_by(least, (reach + BLOCK - 1) / BLOCK));
    int64_t size = contrast.height * contrast.width, count = 0;
    int32_t *label = TAKE(int32_t, size);
    memset(label, 0, sizeof(int32_t) * (size_t)size);
    for (int64_t i = 0; i < size; i++)
        if (contrast.values[i] > level && label[i] == 0 && count <= MAX_BOXES) {
            Box blocks = flood_fill(contrast, level, i, true, label, 1);
            to_pixels(blocks, image, apart + 4 * count++);
        }
    int64_t n = merge_boxes(count, apart);
    for (const double *box = apart; box < apart + 4 * n; box += 4)
        area += (box[2] - box[0] + (double)(4 * reach)) * (box[3] - box[1] + (double)(4 * reach));
    if (count > MAX_BOXES || area > MAX_SHARE * (double)(image.height * image.width)) {
        n = 1;
        to_pixels((Box){0, 0, contrast.width, contrast.height}, image, apart);
    }
    for (int64_t i = 0; i < 4 * n; i++)
        boxes[i] = (int64_t)apart[i];
    return n;
}

int64_t entry_contrast_boxes(int64_t h, int64_t w, const uint8_t *image, int64_t reach,
                             int64_t level, int64_t *boxes)
{
    GUARDED(contrast_boxes((Grid){image, h, w}, reach, level, boxes));
}

static int64_t fill_contrast(Grid image, Box window, int64_t margin, int64_t reach,
                             uint8_t *contrast)
{
    Grid found = top_hat(image, window, margin, reach);
    memcpy(contrast, found.values, (size_t)(found.height * found.width));
    return 0;
}

/* For tests: contrast in a window, filled in. */
int64_t entry_top_hat(int64_t h, int64_t w, const uint8_t *image, int64_t x0, int64_t y0,
                      int64_t x1, int64_t y1, int64_t margin, int64_t reach, uint8_t *contrast)
{
    GUARDED(fill_contrast((Grid){image, h, w}, (Box){x0, y0, x1, y1}, margin, reach, contrast));
}

static int64_t fill_region(Grid contrast, int64_t level, int64_t place, int32_t *label,
                           int32_t number, int64_t *box)
{
    Box found = flood_fill(contrast, level, place, true, label, number);
    int64_t bounds[4] = {found.left, found.top, found.right - 1, found.bottom - 1};
    memcpy(box, bounds, sizeof bounds);
    return 0;
}

/* For tests: `label` (h, w) is changed; `box` (4,), filled: left, top, right, bottom,
 * inclusive. */
int64_t entry_flood_fill(int64_t h, int64_t w, const uint8_t *contrast, int64_t level, int64_t y,
                         int64_t x, int32_t *label, int64_t number, int64_t *box)
{
    GUARDED(fill_region((Grid){contrast, h, w}, level, y * w + x, label, (int32_t)number, box));
}
