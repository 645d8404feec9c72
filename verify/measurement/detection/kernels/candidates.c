/* Find compact bright blobs of a picture, from the highest level of contrast down.
 *
 * Levels are searched from the brightest down, so that a bright blob does not hide a faint
 * neighbour. A blob is measured at half its height. Of the pixels above half the peak and
 * connected with it, holes filled, A many:
 *
 *     half width = sqrt(A / pi),  moments = sum (d d') / A + 1/12,  d px from their mean
 */
#include "verify/measurement/detection/kernels/candidates.h"

#include "verify/core/kernels/linear_algebra.h"
#include "verify/core/kernels/scratch.h"

#define MIN_WINDOW_SIDE 3 /* px, side of a window: smaller ones show no blob */
#define SPAN 32           /* px, passed over at a level that their greatest is below */
#define MAX_REFUSED 64    /* regions without a blob, kept in mind in a window: each slows it */
#define MIN_PIXELS 12     /* px; fewer show no shape */
/* DN above a level, of a peak: nearer, noise tears the top of a disc to pieces, each of which would be
 * a blob. A lower level shows the whole. */
#define MIN_ABOVE_LEVEL 16
#define PI 3.14159265358979323846

/* State of a search: the lowest level, DN; what is labelled with the number of its region; a pixel's
 * place in each region that is settled, as a blob was found in it, or no lower one shows one; blobs
 * found (most, 4). */
typedef struct {
    Grid contrast;
    Shape shape;
    int64_t lowest;
    int32_t *label, number;
    int64_t *seeds, settled, count, most;
    double *found;
} Search;

/* Labels, scratch, of nothing so far. */
static int32_t *no_labels(Grid picture)
{
    int64_t size = picture.height * picture.width;
    int32_t *label = TAKE(int32_t, size);
    memset(label, 0, sizeof(int32_t) * (size_t)size);
    return label;
}

static bool is_too_long(Box box, double side)
{
    return (double)(MAX(box.right - box.left, box.bottom - box.top) - 1) >= side;
}

/* Label, scratch, what is connected with a place once the holes of what is above a level are
 * filled. */
static const int32_t *fill_holes(Grid part, int64_t level, int64_t place)
{
    int64_t size = part.height * part.width;
    uint8_t *lower = TAKE(uint8_t, size);
    for (int64_t i = 0; i < size; i++)
        lower[i] = part.values[i] <= level;
    Grid rimmed = enclose((Grid){lower, part.height, part.width}, 1, 1);
    int32_t *outside = no_labels(rimmed), *filled = no_labels(part);
    flood_fill(rimmed, 0, 0, false, outside, 1);
    for (int64_t y = 0, i = 0; y < part.height; y++)
        for (int64_t x = 0; x < part.width; x++, i++)
            lower[i] = outside[(y + 1) * rimmed.width + x + 1] == 0;
    flood_fill((Grid){lower, part.height, part.width}, 0, place, true, filled, 1);
    return filled;
}

/* Whether a region, labelled 1, is compact, by its pixels above half of the peak.
 *
 * `blob` (4,): centre's column and row, px, and half width, px, are filled in. */
static bool measure_region(Grid part, int64_t half, const int32_t *region, const Shape *shape,
                           double *blob)
{
    int64_t count = 0, x_sum = 0, y_sum = 0, xx_sum = 0, xy_sum = 0, yy_sum = 0;
    for (int64_t y = 0, i = 0; y < part.height; y++)
        for (int64_t x = 0; x < part.width; x++, i++)
            if (region[i] == 1 && part.values[i] > half) {
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

/* Whether a box reaches the border of the picture that holds it. */
static bool reaches_border(Box box, Grid picture)
{
    return box.left == 0 || box.top == 0 || box.right == picture.width ||
           box.bottom == picture.height;
}

/* Measure the brightest blob of a picture at half its height; false: none, or not compact.
 *
 * `part`, DN above the surroundings; a blob not above `above`, DN, has to end in it; `blob` (4,),
 * filled: centre's column and row, px; half width, px; height, DN. */
static bool measure_half_height(Grid part, int64_t above, const Shape *shape, double *blob)
{
    int64_t size = part.height * part.width, peak = greatest(size, part.values);
    int64_t half = peak / 2, place = 0;
    while (part.values[place] < peak)
        place++;
    int32_t *region = no_labels(part);
    Box box = flood_fill(part, half, place, true, region, 1);
    blob[3] = (double)peak;
    bool torn = peak < above && reaches_border(box, part);
    if (torn || is_too_long(box, shape->half_side))
        return false;
    bool alone = true; /* else a hole of the region may hold the others */
    for (int64_t i = 0; i < size; i++)
        alone &= part.values[i] <= half || region[i] == 1;
    return measure_region(part, half, alone ? region : fill_holes(part, half, place), shape, blob);
}

/* Whether the last region is the foot of one of a higher level that is settled. */
static bool has_seed(const Search *search)
{
    bool found = false;
    for (int64_t k = 0; k < search->settled; k++)
        found |= search->label[search->seeds[k]] == search->number;
    return found;
}

/* Cut the last region, above a level, out of its box, scratch; what else is above it there is another
 * one's light, and left out. */
static Grid cut_region(const Search *search, int64_t level, Box box)
{
    int64_t height = box.bottom - box.top, width = box.right - box.left;
    uint8_t *values = TAKE(uint8_t, height * width);
    for (int64_t y = 0; y < height; y++) {
        int64_t row = (box.top + y) * search->contrast.width + box.left;
        for (int64_t x = 0; x < width; x++) {
            uint8_t value = search->contrast.values[row + x];
            bool other = value > level && search->label[row + x] != search->number;
            values[y * width + x] = other ? 0 : value;
        }
    }
    return (Grid){values, height, width};
}

/* Look for a blob in the region of a pixel above a level, and list it. */
static void search_region(Search *search, int64_t level, int64_t place)
{
    search->number++;
    Box box = flood_fill(search->contrast, level, place, true, search->label, search->number);
    if (is_too_long(box, search->shape.side) || search->count == search->most ||
        has_seed(search))
        return;
    Mark mark = scratch_mark();
    double *blob = search->found + 4 * search->count;
    box = widen(box, BOX_MARGIN, search->contrast);
    int64_t above = level > search->lowest ? level + MIN_ABOVE_LEVEL : 0;
    bool compact = measure_half_height(cut_region(search, level, box), above, &search->shape,
                                       blob);
    scratch_release(mark);
    bool refused = 2.0 * (double)level <= blob[3] &&
                   search->settled - search->count < MAX_REFUSED;
    if (compact || refused)
        search->seeds[search->settled++] = place;
    if (compact) {
        blob[0] += (double)box.left;
        blob[1] += (double)box.top;
        search->count++;
    }
}

/* Search the regions above a level that pixels from one place to another are part of, but those
 * that have a number after `before`. */
static void search_span(Search *search, int64_t level, int64_t before, int64_t begin, int64_t end)
{
    const uint8_t *values = search->contrast.values;
    const int32_t *label = search->label;
    int32_t unknown = 0; /* counted first, as most spans have no further region */
    for (int64_t i = begin; i < end; i++)
        unknown += (values[i] > (int32_t)level) & (label[i] <= (int32_t)before);
    for (int64_t i = begin; i < (unknown > 0 ? end : begin); i++)
        if (values[i] > level && label[i] <= before)
            search_region(search, level, i);
}

/* List compact blobs by their contrast, at most so many, and count them; a bright one's foot is no
 * further one.
 *
 * `contrast`, DN above the surroundings. `found` (most, 4) is filled from the first row with as many as
 * it holds: column and row of the centre, px; half width, px; height, DN. */
static int64_t compact_blobs(Grid contrast, const BlobSearch *by, int64_t most, double *found)
{
    Search search = {
        .contrast = contrast,
        .shape = by->shape,
        .lowest = by->levels[by->n_levels - 1],
        .label = no_labels(contrast),
        .seeds = TAKE(int64_t, most + MAX_REFUSED),
        .most = most,
        .found = found,
    };
    int64_t size = contrast.height * contrast.width;
    uint8_t *highest = TAKE(uint8_t, size / SPAN + 1);
    for (int64_t i = 0; i < size; i += SPAN)
        highest[i / SPAN] = greatest(MIN(SPAN, size - i), contrast.values + i);
    for (int64_t k = 0; k < by->n_levels; k++)
        for (int64_t begin = 0, before = search.number; begin < size; begin += SPAN)
            if (highest[begin / SPAN] > by->levels[k])
                search_span(&search, by->levels[k], before, begin, MIN(begin + SPAN, size));
    return search.count;
}

/* List compact bright blobs in windows of a grey picture, (most, 4), as `compact_blobs` does, and
 * count them.
 *
 * `windows` (n, 4): x0, y0, x1, y1, upper bounds exclusive; a `margin`, px, about them is
 * background only. */
static int64_t find_blobs(Grid image, int64_t n, const int64_t *windows, int64_t margin,
                          const BlobSearch *by, double *found)
{
    int64_t count = 0;
    for (const int64_t *bound = windows; bound < windows + 4 * n; bound += 4) {
        Box window = widen((Box){bound[0], bound[1], bound[2], bound[3]}, 0, image);
        if (MIN(window.right - window.left, window.bottom - window.top) < MIN_WINDOW_SIDE)
            continue;
        Mark mark = scratch_mark();
        Grid contrast = top_hat(image, window, margin, by->reach);
        int64_t before = count;
        count += compact_blobs(contrast, by, by->most - count, found + 4 * count);
        scratch_release(mark);
        for (double *blob = found + 4 * before; blob < found + 4 * count; blob += 4) {
            blob[0] += (double)window.left;
            blob[1] += (double)window.top;
        }
    }
    return count;
}

/* Whole pixels of windows (n, 4), upper bounds up, inside an image. */
static int64_t *cut_windows(Grid image, int64_t n, const double *windows)
{
    double most[2] = {(double)image.width, (double)image.height};
    int64_t *bounds = TAKE(int64_t, 4 * n);
    for (int64_t k = 0; k < 4 * n; k++) {
        double inside = MIN(MAX(windows[k], 0.0), most[k % 2]);
        bounds[k] = (int64_t)(k % 4 < 2 ? inside : ceil(inside));
    }
    return bounds;
}

int64_t search_windows(Grid image, int64_t n, const double *windows, const BlobSearch *search,
                       double least, double largest, int64_t most, double *found)
{
    Mark mark = scratch_mark();
    double *blobs = TAKE(double, 4 * search->most), *rank = TAKE(double, search->most);
    int64_t *order = TAKE(int64_t, search->most), count = 0;
    int64_t all = find_blobs(image, n, cut_windows(image, n, windows), 0, search, blobs);
    for (int64_t k = 0; k < all; k++) {
        double width = 2.0 * blobs[4 * k + 2];
        rank[k] = -blobs[4 * k + 3];
        if (least <= width && width <= largest)
            order[count++] = k;
    }
    count = first_by(rank, count, order, most);
    for (int64_t k = 0; k < count; k++)
        copy(found + 4 * k, blobs + 4 * order[k], 4);
    scratch_release(mark);
    return count;
}

/* Entries: images (h, w); shape as `Shape`. */

int64_t entry_find_blobs(int64_t h, int64_t w, const uint8_t *image, int64_t n,
                         const int64_t *windows, int64_t margin, int64_t reach, int64_t n_levels,
                         const int64_t *levels, double side, double half_side, double axis_ratio,
                         double fill, int64_t most, double *found)
{
    BlobSearch by = {reach, n_levels, levels, {side, half_side, axis_ratio, fill}, most};
    GUARDED(find_blobs((Grid){image, h, w}, n, windows, margin, &by, found));
}

int64_t entry_compact_blobs(int64_t h, int64_t w, const uint8_t *contrast, int64_t n_levels,
                            const int64_t *levels, double side, double half_side,
                            double axis_ratio, double fill, int64_t most, double *found)
{
    BlobSearch by = {0, n_levels, levels, {side, half_side, axis_ratio, fill}, most};
    GUARDED(compact_blobs((Grid){contrast, h, w}, &by, most, found));
}
