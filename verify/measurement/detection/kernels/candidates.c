/* Find compact bright blobs of a picture, from the highest level of contrast down.
 *
 * The contrast is the top hat: the image less its opening by a square, which is the greatest of the
 * least values about each pixel. Levels are searched from the brightest down, so that a bright blob
 * does not hide a faint neighbour. OpenCV's top hat takes as many steps a pixel as its square is
 * wide, this one the logarithm of it.
 *
 * A large picture is searched where a block of pixels may exceed the lowest level: its greatest
 * value less the opening of the blocks' least values, which is at most that of the pixels.
 *
 * A blob is measured at half its height. Of the pixels above half the peak and connected with it,
 * holes filled, A many:
 *
 *     half width = sqrt(A / pi),  moments = sum (d d') / A + 1/12,  d px from their mean
 */
#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"
#include "verify/measurement/kernels/alignment.h"

#define MIN_WINDOW_SIDE 3 /* px, side of a window: smaller ones show no blob */
#define BLOCK 16          /* px, side of a block */
#define SPAN 32           /* px of a row, passed over at a level that their greatest is below */
#define MAX_BOXES 64      /* boxes that are searched one by one; with more, as one */
#define MAX_SHARE 0.4     /* of a picture, that these boxes and what is about them may cover */
#define BOX_MARGIN 2      /* px about a region's box: its half height may lie below the level */
#define MAX_REFUSED 64    /* regions without a blob, kept in mind in a window: each slows it */
#define MIN_PIXELS 12     /* px; fewer show no shape */
#define PI 3.14159265358979323846

enum { OUTSIDE, INSIDE };

/* Values (height, width), rows `stride` apart. */
typedef struct {
    const uint8_t *values;
    int64_t height, width, stride;
} Grid;

/* What a picture is filled with, and its box: px, bounds inclusive. */
typedef struct {
    int64_t left, top, right, bottom;
} Box;

typedef struct {
    int32_t y, x;
} Pixel;

/* Longest side of a blob's box, px, at a level and at half height; longest axis ratio; least area
 * over its ellipse's. */
typedef struct {
    double side, half_side, axis_ratio, fill;
} Shape;

/* Search for blobs: what is labelled with the number of its region; a pixel of each region that is
 * settled, as a blob was found in it, or no lower level shows one; blobs found, (most, 4). */
typedef struct {
    Grid contrast;
    Shape shape;
    int32_t *label, number;
    Pixel *stack, *seeds;
    int64_t settled, count, most;
    double *found;
} Search;

/* Fill in the lesser of two values each, (n,). */
static void least_of(int64_t n, const uint8_t *restrict values, const uint8_t *restrict others,
                     uint8_t *restrict least)
{
    #pragma omp simd
    for (int64_t i = 0; i < n; i++)
        least[i] = MIN(values[i], others[i]);
}

/* Least of `count` values from each one on, `step` apart, as a picture (high, wide), scratch.
 *
 * A step of 1 goes along rows, one of `wide` down columns. `part` stands behind rows `above` and
 * columns `beside` of nothing (255) in that picture. What has fewer values ahead of it, at the end,
 * means nothing. */
static uint8_t *least_ahead(Grid part, int64_t above, int64_t beside, int64_t high, int64_t wide,
                            int64_t step, int64_t count)
{
    int64_t end = high * wide, have = 1;
    uint8_t *values = TAKE(uint8_t, end), *spare = TAKE(uint8_t, end);
    memset(values, 255, (size_t)end);
    for (int64_t y = 0; y < part.height; y++)
        memcpy(values + (above + y) * wide + beside, part.values + y * part.stride,
               (size_t)part.width);
    while (have < count) {
        int64_t more = MIN(have, count - have);
        end -= more * step; /* beyond it too few are ahead */
        least_of(end, values, values + more * step, spare);
        uint8_t *held = values;
        values = spare;
        spare = held;
        have += more;
    }
    return values;
}

/* Least value, (high, wide), scratch, in each square of 2 reach + 1 px; nothing is beyond.
 *
 * `above` rows of `part`, and `beside` columns left of it, the first square begins. */
static Grid erode(Grid part, int64_t above, int64_t beside, int64_t high, int64_t wide,
                  int64_t reach)
{
    int64_t side = 2 * reach + 1, broad = wide + side - 1;
    uint8_t *along = least_ahead(part, 0, beside, part.height, broad, 1, side);
    Grid rows = {along, part.height, wide, broad};
    uint8_t *least = least_ahead(rows, above, 0, high + side - 1, wide, wide, side);
    return (Grid){least, high, wide, wide};
}

/* Fill in the contrast in a window (h, w): the image less its opening by a square of
 * 2 reach + 1 px.
 *
 * The window from x0, y0 to x1, y1, px, upper bounds exclusive, is inside the image. A margin
 * about it counts: 0, or no less than 2 reach. Borders hold nothing. */
static void top_hat(Grid image, int64_t x0, int64_t y0, int64_t x1, int64_t y1, int64_t margin,
                    int64_t reach, uint8_t *contrast)
{
    Mark mark = scratch_mark();
    margin = MIN(margin, 2 * reach); /* as far as it looks */
    int64_t left = MAX(x0 - margin, 0), top = MAX(y0 - margin, 0);
    int64_t right = MIN(x1 + margin, image.width), bottom = MIN(y1 + margin, image.height);
    /* where least values are asked for: the window, and as far as it looks for their greatest */
    int64_t west = MAX(x0 - reach, left), north = MAX(y0 - reach, top);
    int64_t wide = MIN(x1 + reach, right) - west, high = MIN(y1 + reach, bottom) - north;
    Grid part = {image.values + top * image.stride + left, bottom - top, right - left,
                 image.stride};
    Grid least = erode(part, reach - north + top, reach - west + left, high, wide, reach);
    uint8_t *complement = TAKE(uint8_t, high * wide); /* its least value is the greatest one */
    for (int64_t i = 0; i < high * wide; i++)
        complement[i] = 255 - least.values[i];
    least.values = complement;
    Grid most = erode(least, reach - y0 + north, reach - x0 + west, y1 - y0, x1 - x0, reach);
    for (int64_t y = 0; y < y1 - y0; y++) {
        const uint8_t *pixel = image.values + (y0 + y) * image.stride + x0;
        const uint8_t *opening = most.values + y * most.stride;
        for (int64_t x = 0; x < x1 - x0; x++)
            contrast[y * (x1 - x0) + x] = pixel[x] - (255 - opening[x]);
    }
    scratch_release(mark);
}

/* Label what is above a level and connected with a pixel, also by corners; give its box.
 *
 * `contrast` has no stride of its own; `label`, of its shape; `stack` has room for all pixels. */
static Box flood_fill(Grid contrast, int64_t level, int64_t y, int64_t x, int32_t *label,
                      int32_t number, Pixel *stack)
{
    int64_t width = contrast.width, waiting = 1;
    Box box = {x, y, x, y};
    stack[0] = (Pixel){(int32_t)y, (int32_t)x};
    label[y * width + x] = number;
    while (waiting > 0) {
        Pixel at = stack[--waiting];
        int64_t west = at.x, east = at.x;
        const uint8_t *value = contrast.values + at.y * width;
        int32_t *row = label + at.y * width;
        while (west > 0 && value[west - 1] > level && row[west - 1] != number)
            row[--west] = number;
        while (east < width - 1 && value[east + 1] > level && row[east + 1] != number)
            row[++east] = number;
        box.left = MIN(box.left, west);
        box.top = MIN(box.top, at.y);
        box.right = MAX(box.right, east);
        box.bottom = MAX(box.bottom, at.y);
        for (int64_t v = at.y - 1; v <= at.y + 1; v += 2) {
            if (v < 0 || v >= contrast.height)
                continue;
            value = contrast.values + v * width;
            row = label + v * width;
            bool run = false; /* of pixels not yet labelled: its first one stands for it */
            for (int64_t u = MAX(west - 1, 0); u < MIN(east + 2, width); u++) {
                bool new = value[u] > level && row[u] != number;
                if (new && !run) {
                    stack[waiting++] = (Pixel){(int32_t)v, (int32_t)u};
                    row[u] = number;
                }
                run = new;
            }
        }
    }
    return box;
}

/* Mark what of the lower pixels is connected to the rim, side by side: the rest are holes.
 *
 * `label` has a rim of one pixel about `part`. */
static void flood_outside(Grid part, int64_t peak, uint8_t *label, Pixel *stack)
{
    static const int32_t DY[4] = {-1, 1, 0, 0}, DX[4] = {0, 0, -1, 1};
    int64_t height = part.height + 2, width = part.width + 2, count = 1;
    stack[0] = (Pixel){0, 0};
    label[0] = OUTSIDE;
    while (count > 0) {
        Pixel at = stack[--count];
        for (int k = 0; k < 4; k++) {
            int64_t v = at.y + DY[k], u = at.x + DX[k];
            if (v < 0 || u < 0 || v >= height || u >= width || label[v * width + u] != INSIDE)
                continue;
            bool rim = v == 0 || u == 0 || v == height - 1 || u == width - 1;
            if (rim || 2 * part.values[(v - 1) * part.width + u - 1] <= peak) {
                stack[count++] = (Pixel){(int32_t)v, (int32_t)u};
                label[v * width + u] = OUTSIDE;
            }
        }
    }
}

/* Label as 1 what is connected with a pixel once the holes of what is above half are filled. */
static void fill_holes(Grid part, int64_t peak, int64_t y, int64_t x, int32_t *region)
{
    Mark mark = scratch_mark();
    int64_t height = part.height + 2, width = part.width + 2; /* with a rim that is no part of it */
    uint8_t *filled = TAKE(uint8_t, height * width);
    int32_t *label = TAKE(int32_t, height * width);
    Pixel *stack = TAKE(Pixel, height * width);
    memset(filled, INSIDE, (size_t)(height * width));
    memset(label, 0, sizeof(int32_t) * (size_t)(height * width));
    flood_outside(part, peak, filled, stack);
    Grid grid = {filled, height, width, width};
    flood_fill(grid, OUTSIDE, y + 1, x + 1, label, 1, stack);
    for (int64_t v = 0; v < part.height; v++)
        memcpy(region + v * part.width, label + (v + 1) * width + 1,
               sizeof(int32_t) * (size_t)part.width);
    scratch_release(mark);
}

/* Whether the region (h, w), labelled 1, is compact, by its pixels above half of the peak.
 *
 * `blob` (4,): centre's column and row, px, and half width, px, are filled in. */
static bool measure_region(Grid part, int64_t peak, const int32_t *region, const Shape *shape,
                           double *blob)
{
    int64_t count = 0, x_sum = 0, y_sum = 0, xx_sum = 0, xy_sum = 0, yy_sum = 0;
    for (int64_t y = 0, i = 0; y < part.height; y++)
        for (int64_t x = 0; x < part.width; x++, i++)
            if (region[i] > 0 && 2 * part.values[i] > peak) {
                count++;
                x_sum += x;
                y_sum += y;
                xx_sum += x * x;
                xy_sum += x * y;
                yy_sum += y * y;
            }
    if (count == 0 || count == part.height * part.width)
        return false;
    double area = (double)count, x = (double)x_sum / area, y = (double)y_sum / area;
    /* a pixel is a square, not a point: its own variance is 1/12 */
    double xx = (double)xx_sum / area - x * x + 1.0 / 12.0;
    double yy = (double)yy_sum / area - y * y + 1.0 / 12.0;
    double xy = (double)xy_sum / area - x * y;
    double mean = (xx + yy) / 2.0, split = hypot((xx - yy) / 2.0, xy);
    double longer = 2.0 * sqrt(mean + split), shorter = 2.0 * sqrt(MAX(mean - split, 0.0));
    blob[0] = x;
    blob[1] = y;
    blob[2] = sqrt(area / PI);
    return count < MIN_PIXELS || (longer <= shape->axis_ratio * shorter &&
                                area >= shape->fill * PI * longer * shorter);
}

/* Measure the brightest blob of a picture at half its height; false: none, or not compact.
 *
 * `part`, DN above the surroundings; `blob` (4,), filled: centre's column and row, px; half width,
 * px; height, DN. */
static bool measure_half_height(Grid part, const Shape *shape, double *blob)
{
    Mark mark = scratch_mark();
    int64_t size = part.height * part.width, at = 0, peak = -1;
    for (int64_t i = 0; i < size; i++)
        if (part.values[i] > peak) {
            at = i;
            peak = part.values[i];
        }
    blob[3] = (double)peak;
    int32_t *region = TAKE(int32_t, size);
    Pixel *stack = TAKE(Pixel, size);
    memset(region, 0, sizeof(int32_t) * (size_t)size);
    int64_t at_y = at / part.width, at_x = at % part.width;
    Box box = flood_fill(part, peak / 2, at_y, at_x, region, 1, stack);
    bool compact = (double)MAX(box.right - box.left, box.bottom - box.top) < shape->half_side;
    if (compact) {
        bool alone = true;
        for (int64_t i = 0; i < size; i++)
            alone &= 2 * part.values[i] <= peak || region[i] == 1;
        if (!alone) /* a hole of the region may hold the others */
            fill_holes(part, peak, at_y, at_x, region);
        compact = measure_region(part, peak, region, shape, blob);
    }
    scratch_release(mark);
    return compact;
}

/* Copy what is in a box and BOX_MARGIN about it, scratch; the box becomes that of the copy. */
static Grid cut_out(Grid contrast, Box *box)
{
    box->left = MAX(box->left - BOX_MARGIN, 0);
    box->top = MAX(box->top - BOX_MARGIN, 0);
    int64_t width = MIN(box->right + BOX_MARGIN + 1, contrast.width) - box->left;
    int64_t height = MIN(box->bottom + BOX_MARGIN + 1, contrast.height) - box->top;
    uint8_t *values = TAKE(uint8_t, height * width);
    for (int64_t y = 0; y < height; y++)
        memcpy(values + y * width,
               contrast.values + (box->top + y) * contrast.stride + box->left, (size_t)width);
    return (Grid){values, height, width, width};
}

/* Whether the last region, of that box, is the foot of one of a higher level that is settled. */
static bool has_seed(const Search *search, Box box)
{
    for (int64_t k = 0; k < search->settled; k++) {
        int64_t y = search->seeds[k].y, x = search->seeds[k].x;
        if (y >= box.top && y <= box.bottom && x >= box.left && x <= box.right &&
            search->label[y * search->contrast.width + x] == search->number)
            return true;
    }
    return false;
}

/* Look for a blob in the region of a pixel above a level, and list it. */
static void search_region(Search *search, int64_t level, int64_t y, int64_t x)
{
    search->number++;
    Box box = flood_fill(search->contrast, level, y, x, search->label, search->number,
                         search->stack);
    if ((double)MAX(box.right - box.left, box.bottom - box.top) >= search->shape.side)
        return;
    if (search->count == search->most || has_seed(search, box))
        return;
    Mark mark = scratch_mark();
    double *blob = search->found + 4 * search->count;
    bool compact = measure_half_height(cut_out(search->contrast, &box), &search->shape, blob);
    scratch_release(mark);
    bool refused = 2.0 * (double)level <= blob[3] &&
                   search->settled - search->count < MAX_REFUSED;
    if (compact || refused)
        search->seeds[search->settled++] = (Pixel){(int32_t)y, (int32_t)x};
    if (compact) {
        blob[0] += (double)box.left;
        blob[1] += (double)box.top;
        search->count++;
    }
}

/* Greatest of (n,). */
static uint8_t greatest(int64_t n, const uint8_t *values)
{
    uint8_t most = 0;
    for (int64_t i = 0; i < n; i++)
        most = MAX(most, values[i]);
    return most;
}

/* Search the regions above a level that SPAN pixels from (x, y) on are part of, but those that
 * have a number after `before`. */
static void search_span(Search *search, int64_t level, int64_t before, int64_t y, int64_t x)
{
    int64_t width = search->contrast.width, end = MIN(x + SPAN, width);
    const uint8_t *value = search->contrast.values + y * width;
    const int32_t *label = search->label + y * width;
    for (; x < end; x++)
        if (value[x] > level && label[x] <= before)
            search_region(search, level, y, x);
}

/* List compact blobs by their contrast, and count them; a bright one's foot is no further one.
 *
 * `contrast`, DN above the surroundings, without a stride of its own; `levels`, DN, falling.
 * `found` (most, 4) is filled from the first row with as many as it holds: column and row of the
 * centre, px; half width, px; height, DN. */
static int64_t compact_blobs(Grid contrast, int64_t n_levels, const int64_t *levels, Shape shape,
                             int64_t most, double *found)
{
    Mark mark = scratch_mark();
    int64_t height = contrast.height, width = contrast.width, size = height * width;
    Search search = {
        .contrast = contrast,
        .shape = shape,
        .label = TAKE(int32_t, size),
        .stack = TAKE(Pixel, size),
        .seeds = TAKE(Pixel, most + MAX_REFUSED),
        .most = most,
        .found = found,
    };
    int64_t spans = (width + SPAN - 1) / SPAN;
    uint8_t *highest = TAKE(uint8_t, height * spans);
    memset(search.label, 0, sizeof(int32_t) * (size_t)size);
    for (int64_t y = 0; y < height; y++)
        for (int64_t k = 0; k < spans; k++)
            highest[y * spans + k] = greatest(MIN(SPAN, width - k * SPAN),
                                              contrast.values + y * width + k * SPAN);
    for (int64_t k = 0; k < n_levels; k++)
        for (int64_t y = 0, before = search.number; y < height; y++)
            for (int64_t span = 0; span < spans; span++)
                if (highest[y * spans + span] > levels[k])
                    search_span(&search, levels[k], before, y, span * SPAN);
    scratch_release(mark);
    return search.count;
}

/* Bound of a window, inside the image. */
static int64_t cut_at(int64_t size, int64_t bound)
{
    return MIN(MAX(bound, 0), size);
}

/* List compact bright blobs in windows of a grey picture, (most, 4), as `compact_blobs` does, and
 * count them.
 *
 * `windows` (n, 4): x0, y0, x1, y1, upper bounds exclusive; a `margin`, px, about them is
 * background only. `reach`, px: what has brightness at that distance all around is background. */
static int64_t find_blobs(Grid image, int64_t n, const int64_t *windows, int64_t margin,
                          int64_t reach, int64_t n_levels, const int64_t *levels, Shape shape,
                          int64_t most, double *found)
{
    int64_t count = 0;
    for (const int64_t *window = windows; window < windows + 4 * n; window += 4) {
        int64_t x0 = cut_at(image.width, window[0]), x1 = cut_at(image.width, window[2]);
        int64_t y0 = cut_at(image.height, window[1]), y1 = cut_at(image.height, window[3]);
        if (MIN(x1 - x0, y1 - y0) < MIN_WINDOW_SIDE)
            continue;
        Mark mark = scratch_mark();
        uint8_t *contrast = TAKE(uint8_t, (x1 - x0) * (y1 - y0));
        top_hat(image, x0, y0, x1, y1, margin, reach, contrast);
        int64_t before = count;
        count += compact_blobs((Grid){contrast, y1 - y0, x1 - x0, x1 - x0}, n_levels, levels, shape,
                               most - count, found + 4 * count);
        scratch_release(mark);
        for (int64_t k = before; k < count; k++) {
            found[4 * k] += (double)x0;
            found[4 * k + 1] += (double)y0;
        }
    }
    return count;
}

/* Fill in the greatest and least values of an image's blocks, (high, wide) of them. */
static void find_extremes(Grid image, int64_t high, int64_t wide, uint8_t *most, uint8_t *least)
{
    Mark mark = scratch_mark();
    size_t width = (size_t)(wide * BLOCK);
    uint8_t *above = TAKE(uint8_t, width), *below = TAKE(uint8_t, width);
    for (int64_t row = 0; row < high; row++) {
        memset(above, 0, width);
        memset(below, 255, width);
        for (int64_t y = row * BLOCK; y < MIN((row + 1) * BLOCK, image.height); y++) {
            const uint8_t *value = image.values + y * image.stride;
            for (int64_t x = 0; x < image.width; x++) {
                above[x] = MAX(above[x], value[x]);
                below[x] = MIN(below[x], value[x]);
            }
        }
        for (int64_t column = 0; column < wide; column++) {
            uint8_t highest = 0, lowest = 255;
            for (int64_t x = column * BLOCK; x < (column + 1) * BLOCK; x++) {
                highest = MAX(highest, above[x]);
                lowest = MIN(lowest, below[x]);
            }
            most[row * wide + column] = highest;
            least[row * wide + column] = lowest;
        }
    }
    scratch_release(mark);
}

/* Box of an image's blocks, px, upper bounds exclusive, and BOX_MARGIN about it. */
static void to_pixels(Box blocks, Grid image, double *box)
{
    box[0] = (double)MAX(BLOCK * blocks.left - BOX_MARGIN, 0);
    box[1] = (double)MAX(BLOCK * blocks.top - BOX_MARGIN, 0);
    box[2] = (double)MIN(BLOCK * (blocks.right + 1) + BOX_MARGIN, image.width);
    box[3] = (double)MIN(BLOCK * (blocks.bottom + 1) + BOX_MARGIN, image.height);
}

/* Fill in boxes (n, 4), disjoint, outside which no pixel's contrast exceeds a level, DN; give n, at
 * most MAX_BOXES.
 *
 * `reach` as for `find_blobs`. Columns: x0, y0, x1, y1, px, upper bounds exclusive. A box includes
 * what is within BOX_MARGIN of such pixels. The whole picture is the one box where they would be
 * many or large. */
static int64_t contrast_boxes(Grid image, int64_t reach, int64_t level, int64_t *boxes)
{
    Mark mark = scratch_mark();
    int64_t height = (image.height + BLOCK - 1) / BLOCK, width = (image.width + BLOCK - 1) / BLOCK;
    int64_t size = height * width, count = 0;
    uint8_t *most = TAKE(uint8_t, size), *least = TAKE(uint8_t, size);
    uint8_t *values = TAKE(uint8_t, size);
    int32_t *label = TAKE(int32_t, size);
    Pixel *stack = TAKE(Pixel, size);
    double apart[4 * (MAX_BOXES + 1)], area = 0.0;
    memset(label, 0, sizeof(int32_t) * (size_t)size);
    find_extremes(image, height, width, most, least);
    top_hat((Grid){least, height, width, width}, 0, 0, width, height, 0,
            (reach + BLOCK - 1) / BLOCK, values);
    for (int64_t i = 0; i < size; i++)
        values[i] += most[i] - least[i];
    Grid contrast = {values, height, width, width};
    for (int64_t i = 0; i < size; i++)
        if (values[i] > level && label[i] == 0 && count <= MAX_BOXES) {
            Box blocks = flood_fill(contrast, level, i / width, i % width, label, 1, stack);
            to_pixels(blocks, image, apart + 4 * count++);
        }
    int64_t n = merge_boxes(count, apart);
    for (int64_t k = 0; k < n; k++) {
        const double *box = apart + 4 * k;
        area += (box[2] - box[0] + (double)(4 * reach)) * (box[3] - box[1] + (double)(4 * reach));
    }
    if (count > MAX_BOXES || area > MAX_SHARE * (double)(image.height * image.width)) {
        n = 1;
        to_pixels((Box){0, 0, width - 1, height - 1}, image, apart);
    }
    for (int64_t i = 0; i < 4 * n; i++)
        boxes[i] = (int64_t)apart[i];
    scratch_release(mark);
    return n;
}

static int64_t fill_one(Grid contrast, int64_t level, int64_t y, int64_t x, int32_t *label,
                        int32_t number, int64_t *box)
{
    Pixel *stack = TAKE(Pixel, contrast.height * contrast.width);
    Box found = flood_fill(contrast, level, y, x, label, number, stack);
    memcpy(box, &found, sizeof found);
    return 0;
}

/* Entries: images (h, w); shapes (4,), as `Shape`. */

int64_t entry_contrast_boxes(int64_t h, int64_t w, const uint8_t *image, int64_t reach,
                             int64_t level, int64_t *boxes)
{
    GUARDED(contrast_boxes((Grid){image, h, w, w}, reach, level, boxes));
}

int64_t entry_find_blobs(int64_t h, int64_t w, const uint8_t *image, int64_t n,
                         const int64_t *windows, int64_t margin, int64_t reach, int64_t n_levels,
                         const int64_t *levels, double side, double half_side, double axis_ratio,
                         double fill, int64_t most, double *found)
{
    Shape shape = {side, half_side, axis_ratio, fill};
    GUARDED(find_blobs((Grid){image, h, w, w}, n, windows, margin, reach, n_levels, levels, shape,
                       most, found));
}

int64_t entry_compact_blobs(int64_t h, int64_t w, const uint8_t *contrast, int64_t n_levels,
                            const int64_t *levels, double side, double half_side,
                            double axis_ratio, double fill, int64_t most, double *found)
{
    Shape shape = {side, half_side, axis_ratio, fill};
    GUARDED(compact_blobs((Grid){contrast, h, w, w}, n_levels, levels, shape, most, found));
}

/* For tests: a window of a picture, which it is inside of; contrast filled in. */
int64_t entry_top_hat(int64_t h, int64_t w, const uint8_t *image, int64_t x0, int64_t y0,
                      int64_t x1, int64_t y1, int64_t margin, int64_t reach, uint8_t *contrast)
{
    GUARDED((top_hat((Grid){image, h, w, w}, x0, y0, x1, y1, margin, reach, contrast), 0));
}

/* For tests: `label` (h, w) is changed; `box` (4,), filled: left, top, right, bottom. */
int64_t entry_flood_fill(int64_t h, int64_t w, const uint8_t *contrast, int64_t level, int64_t y,
                         int64_t x, int32_t *label, int64_t number, int64_t *box)
{
    GUARDED(fill_one((Grid){contrast, h, w, w}, level, y, x, label, (int32_t)number, box));
}
