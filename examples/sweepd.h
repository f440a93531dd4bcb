/* Sweeps, and objects while the head turns, for C99 and C++: layout version 3. Two parts:
 *
 *   the bytes   what a sweep is, and how to read it. Needs nothing but this file and -lm.
 *   receiving   functions of libsweepd.so, at the end of this file: link to it, -lsweepd.
 *
 *     sweepd_client *client = sweepd_client_open("roof", NULL);
 *     sweepd_sample *sample;
 *     int32_t next;
 *     while (!stop && (next = sweepd_client_next(client, 1000000000, &sample)) != SWEEPD_NEXT_FAILED) {
 *         size_t len;
 *         if (next != SWEEPD_NEXT_RECEIVED) continue;
 *         const void *bytes = sweepd_sample_bytes(sample, &len);
 *         sweepd_sweep sweep;
 *         if (sweepd_open(bytes, len, &sweep) == SWEEPD_OK)
 *             for (uint32_t column = 0; column < sweep.columns_len; column++)
 *                 for (uint32_t row = 0; row < sweep.rows; row++) {
 *                     size_t pixel = sweepd_pixel(&sweep, row, column);
 *                     double xyz[3];
 *                     if (!sweepd_is_return(sweep.range[pixel])) continue;
 *                     sweepd_point_m(&sweep, row, column, sweep.range[pixel], xyz);
 *                 }
 *         sweepd_sample_release(sample);
 *     }
 *     sweepd_client_close(client);
 *
 * C++17 has the same in sweepd.hpp. docs/layout.md says what each field means. */

#ifndef SWEEPD_H
#define SWEEPD_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the layout of a sweep is little-endian, and so must be the host"
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Written from the Rust types by SWEEPD_WRITE_PAGES=1 cargo test -p sweepd-sweep --test fields.
 * begin fields: all */
/* What all sweeps have in common. */
#define SWEEPD_MAGIC "sweepd\r\n" /* first bytes of a sweep */
#define SWEEPD_LAYOUT_VERSION 3u /* version of this layout */
#define SWEEPD_ALIGN 64u /* alignment of a sweep and of its parts, bytes */

/* Labels of a pixel; segments count from the last one on. */
#define SWEEPD_LABEL_NONE 0u /* label of a pixel without segment */
#define SWEEPD_LABEL_GROUND 1u /* label of a ground pixel */
#define SWEEPD_LABEL_FIRST_SEGMENT 2u /* label of the first segment */

/* Properties of a sweep, as bits of flags. */
#define SWEEPD_PARTIAL 1u /* not from cut to cut */
#define SWEEPD_CIRCULAR 2u /* a whole turn without a blanked sector */
#define SWEEPD_REVERSED 4u /* the head turns counter-clockwise seen from above */
#define SWEEPD_BLANKED 8u /* the sensor is set to leave out a sector */
#define SWEEPD_RATE_UNSTABLE 16u /* turning slower than 240 rpm, faster than 1320, or more than a tenth off the sweep before */
#define SWEEPD_STOPPED 32u /* the head stands still */
#define SWEEPD_HEIGHT_ESTIMATED 64u /* the mounting height was estimated from the sweeps and not configured */
#define SWEEPD_LOSS_ESTIMATED 128u /* lost_packets is an estimate */
#define SWEEPD_BLIND 256u /* hardly a shot has returned for eye_turns turns */
#define SWEEPD_COVERED 512u /* nearly all returns are within eye_near_m, all around */
#define SWEEPD_FROZEN 1024u /* ranges or reflectivities are the same, turn after turn */
#define SWEEPD_FADED 2048u /* less than eye_least_percent of the returns of before are left, also of those from near ground */
#define SWEEPD_DARK_BELOW 4096u /* beams or a sector that look down to near ground do not return */
#define SWEEPD_HEIGHT_IN_DOUBT 8192u /* the mounting height was to be estimated, and is in doubt or unknown */
#define SWEEPD_NOT_SEEING 0x1F00u /* all bits that say that the sensor does not see what it should */

/* Properties of a segment, as bits of flags. */
#define SWEEPD_SEGMENT_WIDE 1u /* wider than max_object_deg (60 degrees by default), or with the sensor inside its box */

/* Which clock time_ns is in. */
#define SWEEPD_TIME_HOST 0u /* the clock of the host or the capture */
#define SWEEPD_TIME_GPS 1u /* UTC from GPS */

/* Which of two returns is segmented. */
#define SWEEPD_CHOICE_NEAREST 0u /* the nearer */
#define SWEEPD_CHOICE_STRONGEST 1u /* the strongest */
#define SWEEPD_CHOICE_LAST 2u /* the last */

/* The parts of a sweep behind its header. */
enum sweepd_part {
    SWEEPD_PART_RANGE,
    SWEEPD_PART_REFLECTIVITY,
    SWEEPD_PART_LABEL,
    SWEEPD_PART_RANGE2,
    SWEEPD_PART_REFLECTIVITY2,
    SWEEPD_PART_LABEL2,
    SWEEPD_PART_KIND,
    SWEEPD_PART_COLUMNS,
    SWEEPD_PART_BEAMS,
    SWEEPD_PART_SEGMENTS,
    SWEEPD_PARTS
};

/* Which of a pair of dual returns a plane holds. */
#define SWEEPD_KIND_STRONGEST 1u /* the strongest, or the second strongest where the last is the strongest */
#define SWEEPD_KIND_LAST 2u /* the last */
#define SWEEPD_KIND_SECOND_BLOCKS 4u /* bit of PART_KIND */

/* The status: what a column holds. */
#define SWEEPD_COLUMN_MEASURED 1u /* a firing that arrived */
#define SWEEPD_COLUMN_MISSING 2u /* a firing whose packet was lost */
#define SWEEPD_COLUMN_UNFIRED 3u /* no firing */

/* A supported sensor model. */
#define SWEEPD_MODEL_VLP16 1u /* VLP-16 "Puck" */
#define SWEEPD_MODEL_PUCK_LITE 2u /* Puck LITE */
#define SWEEPD_MODEL_PUCK_HIRES 3u /* Puck Hi-Res */
#define SWEEPD_MODEL_HDL32E 4u /* HDL-32E */
#define SWEEPD_MODEL_HDL64E_S2 5u /* HDL-64E S2 and S2.1 */
#define SWEEPD_MODEL_HDL64E_S3 6u /* HDL-64E S3 */
#define SWEEPD_MODEL_VLP32C 7u /* VLP-32C "Ultra Puck", and VLP-32MR, which has the same beams */
#define SWEEPD_MODEL_VLS128 8u /* VLS-128 "Alpha Prime" */

/* The return mode. */
#define SWEEPD_MODE_STRONGEST 0x37u /* the strongest return of each shot */
#define SWEEPD_MODE_LAST 0x38u /* the last return of each shot */
#define SWEEPD_MODE_DUAL 0x39u /* two returns of each shot */

/* What all messages of objects have in common. */
#define SWEEPD_OBJECTS_VERSION 1u /* version of a message of objects */
#define SWEEPD_OBJECTS_MAGIC "objects\n" /* first bytes of a message of objects */

/* Why an object is emitted. */
#define SWEEPD_WHY_COMPLETE 1u /* a whole segment that no later column of this turn can join */
#define SWEEPD_WHY_SWEEP 2u /* a whole segment that is published with its complete sweep */
#define SWEEPD_WHY_WIDE 3u /* a part of an object wider than max_object_deg, published while the object grows */
#define SWEEPD_WHY_SEAM 4u /* an object across the cut or close behind it, with its returns of the previous turn */

/* Properties of a message of objects, as bits of flags. */
#define SWEEPD_OBJECTS_LAST 1u /* the last message of the sweep */
#define SWEEPD_OBJECTS_NO_HEIGHT 2u /* the height of the sensor is not known yet */
#define SWEEPD_OBJECTS_PARTIAL 4u /* the sweep does not go from cut to cut */

typedef struct sweepd_preamble {
    uint32_t layout_version;
    uint32_t reserved_4;
    uint64_t sweep_bytes;
    uint8_t reserved_16[48];
} sweepd_preamble;

typedef struct sweepd_header {
    uint8_t magic[8];
    uint32_t version;
    uint32_t header_bytes;
    uint64_t total_bytes;
    uint64_t offsets[SWEEPD_PARTS];
    uint32_t rows;
    uint32_t columns;
    uint32_t columns_capacity;
    uint32_t segments;
    uint32_t segments_capacity;
    uint32_t model;
    uint32_t return_mode;
    uint32_t return_choice;
    uint32_t flags;
    uint32_t time_source;
    uint64_t sequence;
    int64_t time_ns;
    uint64_t duration_ns;
    int64_t sensor_time_ns;
    int64_t arrival_ns;
    float rpm;
    float cut_azimuth_rad;
    float height_m;
    float pitch_rad;
    float roll_rad;
    uint32_t missing_columns;
    uint32_t lost_packets;
    uint32_t packets;
    uint32_t returns;
    uint32_t ground;
    uint32_t decode_ns;
    uint32_t ground_ns;
    uint32_t label_ns;
    uint32_t margin_columns;
    uint32_t unfired_columns;
    uint32_t dropped_datagrams;
    float yaw_rad;
    uint32_t height_doubt;
    float position_m[3];
    uint32_t reserved_268;
    int64_t completed_ns;
    int64_t completed_monotonic_ns;
    int64_t run_ns;
    char sensor[64];
    char name[64];
    uint8_t reserved_424[24];
} sweepd_header;

typedef struct sweepd_column {
    uint64_t packet;
    float azimuth_rad;
    float azimuth_rate_rad_s;
    uint32_t time_ns;
    uint8_t block;
    uint8_t status;
    uint8_t reserved_22[2];
} sweepd_column;

typedef struct sweepd_beam {
    uint32_t channel;
    float elevation_rad;
    float rotation_rad;
    uint32_t time_offset_ns;
    float vertical_offset_m;
    float horizontal_offset_m;
    int32_t shift;
    float distance_offset_m;
    float distance_offset_x_m;
    float distance_offset_y_m;
    uint32_t reserved_40[2];
} sweepd_beam;

typedef struct sweepd_segment {
    uint32_t label;
    uint32_t points;
    float min_m[3];
    float max_m[3];
    float centroid_m[3];
    float nearest_m;
    uint16_t row_first;
    uint16_t row_last;
    uint32_t column_first;
    uint32_t column_last;
    uint16_t flags;
    uint16_t reserved_62;
} sweepd_segment;

typedef struct sweepd_object {
    sweepd_segment segment;
    uint32_t first_pixel;
    uint32_t ordinal;
    uint32_t why;
    float azimuth_first_rad;
    float azimuth_last_rad;
    int32_t first_ns;
    int32_t last_ns;
    uint32_t reserved_92;
} sweepd_object;

typedef struct sweepd_objects_header {
    uint8_t magic[8];
    uint32_t version;
    uint32_t header_bytes;
    uint64_t sequence;
    int64_t run_ns;
    int64_t time_ns;
    int64_t sent_ns;
    int64_t sent_monotonic_ns;
    uint32_t time_source;
    uint32_t flags;
    uint32_t objects;
    uint32_t first_ordinal;
    uint32_t labels;
    uint32_t first_label;
    float position_m[3];
    float yaw_rad;
    float pitch_rad;
    float roll_rad;
    float height_m;
    uint8_t reserved_108[20];
    char name[64];
} sweepd_objects_header;

#define SWEEPD_ASSERT(what, name) typedef char sweepd_assert_##name[(what) ? 1 : -1]
SWEEPD_ASSERT(sizeof(float) == 4 && sizeof(double) == 8, floats);
SWEEPD_ASSERT(sizeof(sweepd_preamble) == 64, preamble);
SWEEPD_ASSERT(sizeof(sweepd_header) == 448, header);
SWEEPD_ASSERT(sizeof(sweepd_column) == 24, column);
SWEEPD_ASSERT(sizeof(sweepd_beam) == 48, beam);
SWEEPD_ASSERT(sizeof(sweepd_segment) == 64, segment);
SWEEPD_ASSERT(sizeof(sweepd_object) == 96, object);
SWEEPD_ASSERT(sizeof(sweepd_objects_header) == 192, objects_header);
#undef SWEEPD_ASSERT
/* end fields */

/* What is found of bytes. */
typedef enum sweepd_status {
    SWEEPD_OK = 0,
    SWEEPD_TOO_SHORT_OR_UNALIGNED = 1, /* too few bytes, or they do not begin at a multiple of 8 */
    SWEEPD_OTHER_VERSION = 2,          /* no sweep or no objects, or those of another version */
    SWEEPD_INCONSISTENT = 3            /* counts and offsets contradict each other */
} sweepd_status;

/* A sweep to read: where its planes and tables are, trimmed to the columns and segments that there are. It is as good as
 * the bytes are: valid while they are held. Index planes by sweepd_pixel. The header is a copy, the one that was checked:
 * whatever a publisher should write into its own afterwards, nothing here leads outside of the bytes. */
typedef struct sweepd_sweep {
    sweepd_header header;
    const float *range;           /* metres; see sweepd_is_return */
    const uint8_t *reflectivity;
    const uint32_t *label;
    const float *range2;          /* the other return; NULL in single mode, as the next three */
    const uint8_t *reflectivity2;
    const uint32_t *label2;
    const uint8_t *kind;
    const sweepd_column *columns;
    const sweepd_beam *beams;
    const sweepd_segment *segments;
    uint32_t rows;
    uint32_t columns_len;
    uint32_t segments_len;
} sweepd_sweep;

/* Objects that became known together: where they and their labels are. As a sweep is, it is valid while the bytes are held,
 * and its header is the copy that was checked. The labels are those of the sweep's objects from header.first_label on. */
typedef struct sweepd_objects {
    sweepd_objects_header header;
    const sweepd_object *objects;
    const uint32_t *labels;
    uint32_t objects_len;
    uint32_t labels_len;
} sweepd_objects;

/* Where each part of a header's shape begins (0 = absent); gives the bytes of the whole. */
static inline uint64_t sweepd_offsets(const sweepd_header *header, uint64_t offsets[SWEEPD_PARTS]) {
    const uint64_t pixels = (uint64_t)header->rows * header->columns_capacity;
    const uint64_t other = header->offsets[SWEEPD_PART_RANGE2] != 0 ? pixels : 0;
    uint64_t sizes[SWEEPD_PARTS], end = sizeof(sweepd_header);
    int part;
    sizes[SWEEPD_PART_RANGE] = pixels * sizeof(float);
    sizes[SWEEPD_PART_REFLECTIVITY] = pixels;
    sizes[SWEEPD_PART_LABEL] = pixels * sizeof(uint32_t);
    sizes[SWEEPD_PART_RANGE2] = other * sizeof(float);
    sizes[SWEEPD_PART_REFLECTIVITY2] = other;
    sizes[SWEEPD_PART_LABEL2] = other * sizeof(uint32_t);
    sizes[SWEEPD_PART_KIND] = other;
    sizes[SWEEPD_PART_COLUMNS] = header->columns_capacity * (uint64_t)sizeof(sweepd_column);
    sizes[SWEEPD_PART_BEAMS] = header->rows * (uint64_t)sizeof(sweepd_beam);
    sizes[SWEEPD_PART_SEGMENTS] = header->segments_capacity * (uint64_t)sizeof(sweepd_segment);
    for (part = 0; part < SWEEPD_PARTS; part++) {
        offsets[part] = sizes[part] > 0 ? end : 0;
        end += sizes[part];
        if (sizes[part] > 0) end = (end + SWEEPD_ALIGN - 1) / SWEEPD_ALIGN * SWEEPD_ALIGN;
    }
    return end;
}

/* Copies bytes that a publisher may be writing, each word read once. */
static inline void sweepd_copy(const void *bytes, uint64_t *words, size_t len) {
    const volatile uint64_t *from = (const volatile uint64_t *)bytes;
    size_t word;
    for (word = 0; word < len / 8; word++) words[word] = from[word];
}

/* Copies the header of some bytes and says whether they are a sweep of this layout, so that nothing that the copy tells lies
 * outside of them. */
static inline sweepd_status sweepd_take_header(const void *bytes, size_t len, sweepd_header *header) {
    uint64_t offsets[SWEEPD_PARTS], total, words[sizeof(sweepd_header) / 8];
    if (len < sizeof(sweepd_header) || (uintptr_t)bytes % 8 != 0) return SWEEPD_TOO_SHORT_OR_UNALIGNED;
    sweepd_copy(bytes, words, sizeof words);
    memcpy(header, words, sizeof words);
    if (memcmp(header->magic, SWEEPD_MAGIC, sizeof header->magic) != 0) return SWEEPD_OTHER_VERSION;
    if (header->version != SWEEPD_LAYOUT_VERSION) return SWEEPD_OTHER_VERSION;
    if (header->rows > 256 || header->columns_capacity > 1u << 20 || header->segments_capacity > 1u << 28 ||
        (uint64_t)header->margin_columns + header->columns > header->columns_capacity ||
        header->segments > header->segments_capacity)
        return SWEEPD_INCONSISTENT;
    total = sweepd_offsets(header, offsets);
    if (memcmp(offsets, header->offsets, sizeof offsets) != 0 || total != header->total_bytes) return SWEEPD_INCONSISTENT;
    return total > len ? SWEEPD_TOO_SHORT_OR_UNALIGNED : SWEEPD_OK;
}

/* Whether bytes are a sweep of this layout. */
static inline sweepd_status sweepd_check(const void *bytes, size_t len) {
    sweepd_header header;
    return sweepd_take_header(bytes, len, &header);
}

/* Checks the bytes of a sweep and tells where everything is. */
static inline sweepd_status sweepd_open(const void *bytes, size_t len, sweepd_sweep *sweep) {
    const uint8_t *base = (const uint8_t *)bytes;
    const sweepd_header *header = &sweep->header;
    const uint64_t *at;
    sweepd_status status;
    size_t before;
    memset(sweep, 0, sizeof *sweep);
    status = sweepd_take_header(bytes, len, &sweep->header);
    if (status != SWEEPD_OK) return status;
    at = header->offsets;
    before = (size_t)header->margin_columns * header->rows;
    sweep->rows = header->rows;
    sweep->columns_len = header->columns;
    sweep->segments_len = header->segments;
    sweep->range = (const float *)(const void *)(base + at[SWEEPD_PART_RANGE]) + before;
    sweep->reflectivity = base + at[SWEEPD_PART_REFLECTIVITY] + before;
    sweep->label = (const uint32_t *)(const void *)(base + at[SWEEPD_PART_LABEL]) + before;
    if (at[SWEEPD_PART_RANGE2] != 0) {
        sweep->range2 = (const float *)(const void *)(base + at[SWEEPD_PART_RANGE2]) + before;
        sweep->reflectivity2 = base + at[SWEEPD_PART_REFLECTIVITY2] + before;
        sweep->label2 = (const uint32_t *)(const void *)(base + at[SWEEPD_PART_LABEL2]) + before;
        sweep->kind = base + at[SWEEPD_PART_KIND] + before;
    }
    sweep->columns = (const sweepd_column *)(const void *)(base + at[SWEEPD_PART_COLUMNS]) + header->margin_columns;
    sweep->beams = (const sweepd_beam *)(const void *)(base + at[SWEEPD_PART_BEAMS]);
    sweep->segments = (const sweepd_segment *)(const void *)(base + at[SWEEPD_PART_SEGMENTS]);
    return SWEEPD_OK;
}

/* Checks the bytes of a message of objects and tells where everything is. */
static inline sweepd_status sweepd_objects_open(const void *bytes, size_t len, sweepd_objects *objects) {
    const uint8_t *base = (const uint8_t *)bytes;
    sweepd_objects_header *header = &objects->header;
    uint64_t words[sizeof(sweepd_objects_header) / 8], of_objects, total;
    memset(objects, 0, sizeof *objects);
    if (len < sizeof words || (uintptr_t)bytes % 8 != 0) return SWEEPD_TOO_SHORT_OR_UNALIGNED;
    sweepd_copy(bytes, words, sizeof words);
    memcpy(header, words, sizeof words);
    if (memcmp(header->magic, SWEEPD_OBJECTS_MAGIC, sizeof header->magic) != 0) return SWEEPD_OTHER_VERSION;
    if (header->version != SWEEPD_OBJECTS_VERSION) return SWEEPD_OTHER_VERSION;
    of_objects = header->objects * (uint64_t)sizeof(sweepd_object);
    total = sizeof words + of_objects + header->labels * (uint64_t)sizeof(uint32_t);
    if (total > len) return SWEEPD_TOO_SHORT_OR_UNALIGNED;
    objects->objects = (const sweepd_object *)(const void *)(base + sizeof words);
    objects->labels = (const uint32_t *)(const void *)(base + sizeof words + of_objects);
    objects->objects_len = header->objects;
    objects->labels_len = header->labels;
    return SWEEPD_OK;
}

/* Index of a pixel in each plane. */
static inline size_t sweepd_pixel(const sweepd_sweep *sweep, uint32_t row, uint32_t column) {
    return (size_t)column * sweep->rows + row;
}

/* Whether a range in a plane is a return. */
static inline int sweepd_is_return(float range_m) {
    return range_m > 0.0f;
}

/* SWEEPD_KIND_STRONGEST or SWEEPD_KIND_LAST: what the return of a pixel is, or (`other`) that of the planes "2". */
static inline uint32_t sweepd_kind(const sweepd_sweep *sweep, uint32_t row, uint32_t column, int other) {
    int is_last = sweep->header.return_mode == SWEEPD_MODE_LAST;
    if (sweep->kind != NULL) {
        const uint8_t byte = sweep->kind[sweepd_pixel(sweep, row, column)];
        is_last = ((byte & ~SWEEPD_KIND_SECOND_BLOCKS) == SWEEPD_KIND_LAST) != (other != 0);
    }
    return is_last ? SWEEPD_KIND_LAST : SWEEPD_KIND_STRONGEST;
}

/* The column in which a pixel was fired: its own, moved by the shift of its row. Beyond the ends of an image that is not
 * circular, where no pixel has a return, the one at the end. */
static inline uint32_t sweepd_fired_in(const sweepd_sweep *sweep, uint32_t row, uint32_t column) {
    const int64_t columns = sweep->columns_len;
    int64_t at = (int64_t)column + sweep->beams[row].shift;
    if (at >= 0 && at < columns) return (uint32_t)at;
    if (sweep->header.flags & SWEEPD_CIRCULAR) {
        at %= columns;
        return (uint32_t)(at < 0 ? at + columns : at);
    }
    return at < 0 ? 0 : (uint32_t)(columns - 1);
}

/* Azimuth of a pixel's beam when it fired, radians, 0..2 pi, clockwise from +y. */
static inline double sweepd_azimuth_rad(const sweepd_sweep *sweep, uint32_t row, uint32_t column) {
    const double turn = 6.283185307179586476925287;
    const sweepd_column *firing = &sweep->columns[sweepd_fired_in(sweep, row, column)];
    const sweepd_beam *beam = &sweep->beams[row];
    const double turned = (double)firing->azimuth_rate_rad_s * (double)beam->time_offset_ns * 1e-9;
    double azimuth = fmod((double)firing->azimuth_rad + turned - (double)beam->rotation_rad, turn);
    if (azimuth < 0.0) azimuth += turn;
    return azimuth < turn ? azimuth : 0.0;
}

/* When a pixel's beam fired, nanoseconds since 1970 in the clock of sweepd_header.time_source. */
static inline int64_t sweepd_time_ns(const sweepd_sweep *sweep, uint32_t row, uint32_t column) {
    const sweepd_column *firing = &sweep->columns[sweepd_fired_in(sweep, row, column)];
    const int64_t after = (int64_t)firing->time_ns + (int64_t)sweep->beams[row].time_offset_ns;
    return sweep->header.time_ns > INT64_MAX - after ? INT64_MAX : sweep->header.time_ns + after;
}

/* x right, y forward, z up of a range in a pixel, metres from the sensor's origin. */
static inline void sweepd_point_m(const sweepd_sweep *sweep, uint32_t row, uint32_t column, float range_m, double xyz[3]) {
    const sweepd_beam *beam = &sweep->beams[row];
    const double azimuth = sweepd_azimuth_rad(sweep, row, column);
    const double sin_azimuth = sin(azimuth), cos_azimuth = cos(azimuth);
    const double sin_elevation = sin((double)beam->elevation_rad), cos_elevation = cos((double)beam->elevation_rad);
    const double along[2] = {cos_elevation * sin_azimuth, cos_elevation * cos_azimuth};
    const double far_m = 25.04, range = (double)range_m;
    /* The two-point correction of an HDL-64E: what it adds at the axis' zero, and loses each metre. */
    const double slope[2] = {((double)beam->distance_offset_x_m - (double)beam->distance_offset_m) / (far_m - 2.40),
                             ((double)beam->distance_offset_y_m - (double)beam->distance_offset_m) / (far_m - 1.93)};
    uint32_t bits;
    xyz[0] = along[0] * range;
    xyz[1] = along[1] * range;
    xyz[2] = sin_elevation * range;
    memcpy(&bits, &range_m, sizeof bits);
    if ((bits & 1) != 0 && (slope[0] != 0.0 || slope[1] != 0.0)) {
        /* Each axis is a multiple of d and a constant; d is the one at which the length is the range. */
        const double of_x[2] = {1.0 - slope[0] * fabs(along[0]), slope[0] * far_m};
        const double of_y[2] = {1.0 - slope[1] * fabs(along[1]), slope[1] * far_m};
        const double x[2] = {of_x[0] * along[0], of_x[1] * along[0]};
        const double y[2] = {of_y[0] * along[1], of_y[1] * along[1]};
        const double z[2] = {(of_x[0] + of_y[0]) / 2.0 * sin_elevation, (of_x[1] + of_y[1]) / 2.0 * sin_elevation};
        const double square = x[0] * x[0] + y[0] * y[0] + z[0] * z[0];
        const double linear = x[0] * x[1] + y[0] * y[1] + z[0] * z[1];
        const double rest = x[1] * x[1] + y[1] * y[1] + z[1] * z[1] - range * range;
        const double root = linear * linear - square * rest;
        if (root >= 0.0 && square > 0.0) {
            const double d = (sqrt(root) - linear) / square;
            xyz[0] = x[0] * d + x[1];
            xyz[1] = y[0] * d + y[1];
            xyz[2] = z[0] * d + z[1];
        }
    }
    /* Where the beam begins. */
    xyz[0] -= (double)beam->horizontal_offset_m * cos_azimuth;
    xyz[1] += (double)beam->horizontal_offset_m * sin_azimuth;
    xyz[2] += (double)beam->vertical_offset_m;
}

/* The pose of a frame in another: it brings the points of the first into the second. */
typedef struct sweepd_pose {
    double rotation[3][3]; /* row by row */
    double position_m[3];
} sweepd_pose;

/* A position, metres, and a rotation as odometry has it: x, y, z, w of a quaternion of any length but 0. */
static inline sweepd_pose sweepd_pose_of(const double position_m[3], const double quaternion[4]) {
    const double x = quaternion[0], y = quaternion[1], z = quaternion[2], w = quaternion[3];
    const double s = 2.0 / (x * x + y * y + z * z + w * w);
    const sweepd_pose pose = {{{1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)},
                               {s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)},
                               {s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)}},
                              {position_m[0], position_m[1], position_m[2]}};
    return pose;
}

/* A sensor in the frame of the robot: x right, y forward, z up. It is rolled about its own y axis, pitched about x, turned
 * about z, then moved. */
static inline sweepd_pose sweepd_mounted(const float at[3], float yaw_rad, float pitch_rad, float roll_rad) {
    const double sr = sin((double)roll_rad), cr = cos((double)roll_rad);
    const double sp = sin((double)pitch_rad), cp = cos((double)pitch_rad);
    const double sy = sin((double)yaw_rad), cy = cos((double)yaw_rad);
    const sweepd_pose pose = {{{cy * cr - sy * sp * sr, -sy * cp, cy * sr + sy * sp * cr},
                               {sy * cr + cy * sp * sr, cy * cp, sy * sr - cy * sp * cr},
                               {-cp * sr, sp, cp * cr}},
                              {(double)at[0], (double)at[1], (double)at[2]}};
    return pose;
}

/* The sensor in the frame of the robot, as configured. */
static inline sweepd_pose sweepd_mount(const sweepd_header *header) {
    return sweepd_mounted(header->position_m, header->yaw_rad, header->pitch_rad, header->roll_rad);
}

/* The same from the header of objects. */
static inline sweepd_pose sweepd_objects_mount(const sweepd_objects_header *header) {
    return sweepd_mounted(header->position_m, header->yaw_rad, header->pitch_rad, header->roll_rad);
}

/* z of the floor in the frame of the robot, metres, from position_m and height_m of either header: as far below the sensor as its
 * height says, and never above the origin. NaN while neither the height nor a z_m over 0 is known. */
static inline double sweepd_floor_m(const float position_m[3], float height_m) {
    if (!(position_m[2] > 0.0f) && !(height_m > 0.0f)) return (double)NAN;
    return fmin((double)position_m[2] - (double)height_m, 0.0);
}

/* From x right, y forward, z up to the axes of ROS: x forward, y left, z up. */
static inline sweepd_pose sweepd_ros(void) {
    const sweepd_pose pose = {{{0.0, 1.0, 0.0}, {-1.0, 0.0, 0.0}, {0.0, 0.0, 1.0}}, {0.0, 0.0, 0.0}};
    return pose;
}

/* A point of the frame, metres, in the other; both may be the same memory. */
static inline void sweepd_apply(const sweepd_pose *pose, const double point[3], double xyz[3]) {
    const double x = point[0], y = point[1], z = point[2];
    int axis;
    for (axis = 0; axis < 3; axis++) {
        const double *row = pose->rotation[axis];
        xyz[axis] = row[0] * x + row[1] * y + row[2] * z + pose->position_m[axis];
    }
}

/* The box around a segment's box in the other frame: least and greatest x, y and z, metres. */
static inline void sweepd_bounds(const sweepd_pose *pose, const sweepd_segment *segment, double bounds_m[2][3]) {
    int axis, of;
    for (axis = 0; axis < 3; axis++) {
        bounds_m[0][axis] = bounds_m[1][axis] = pose->position_m[axis];
        for (of = 0; of < 3; of++) {
            const double one = pose->rotation[axis][of] * (double)segment->min_m[of];
            const double other = pose->rotation[axis][of] * (double)segment->max_m[of];
            bounds_m[0][axis] += fmin(one, other);
            bounds_m[1][axis] += fmax(one, other);
        }
    }
}

/* One pose after another: world from robot, robot from sensor gives world from sensor. */
static inline sweepd_pose sweepd_chain(const sweepd_pose *outer, const sweepd_pose *inner) {
    sweepd_pose pose;
    int row, axis;
    for (row = 0; row < 3; row++)
        for (axis = 0; axis < 3; axis++)
            pose.rotation[row][axis] = outer->rotation[row][0] * inner->rotation[0][axis] +
                                       outer->rotation[row][1] * inner->rotation[1][axis] +
                                       outer->rotation[row][2] * inner->rotation[2][axis];
    sweepd_apply(outer, inner->position_m, pose.position_m);
    return pose;
}

/* The points of a plane, `range` or `range2`, in another frame: `pose_at` gives the pose of the sensor in it at the time of
 * the pixel's own shot. `xyz` has room for columns_len * rows points, metres, in the order of the plane; NaN where there is
 * no return. With the poses of a moving sensor, this deskews the sweep. */
static inline void sweepd_points_in(const sweepd_sweep *sweep, const float *plane,
                                    sweepd_pose (*pose_at)(int64_t time_ns, void *context), void *context,
                                    double (*xyz)[3]) {
    uint32_t row, column;
    for (column = 0; column < sweep->columns_len; column++)
        for (row = 0; row < sweep->rows; row++) {
            const size_t pixel = sweepd_pixel(sweep, row, column);
            xyz[pixel][0] = xyz[pixel][1] = xyz[pixel][2] = (double)NAN;
            if (sweepd_is_return(plane[pixel])) {
                const sweepd_pose pose = pose_at(sweepd_time_ns(sweep, row, column), context);
                sweepd_point_m(sweep, row, column, plane[pixel], xyz[pixel]);
                sweepd_apply(&pose, xyz[pixel], xyz[pixel]);
            }
        }
}

/* ---- Receiving: libsweepd.so ----
 *
 * A program may be started before the daemon, and goes on when that was restarted. It must run as the daemon's user. It handles
 * its signals itself: libsweepd handles none. A text that a function takes is UTF-8 and ends in a zero.
 *
 * A client and its samples belong to the process that opened the client. After fork() the child cannot use those of its parent: the
 * functions fail, and sweepd_client_close and sweepd_sample_release do nothing, so that the parent keeps what it holds. The child
 * opens a client of its own. Nor may it read bytes that it found before fork(): the parent may give them back at any time.
 * A child in a PID namespace of its own, which may have its parent's number there, must not touch them at all. */

#define SWEEPD_ABI_VERSION 1u /* of the functions below */

/* The version of the library. The loader finds only one of SWEEPD_ABI_VERSION; this is for a program that loads it itself. */
uint32_t sweepd_abi_version(void);

/* Follows the sweeps, or the objects, of one sensor. Calls from several threads wait for each other: while one is in
 * sweepd_client_next, even the shortest question waits until that ends. Give it a limit. */
typedef struct sweepd_client sweepd_client;

/* A sweep, or a message of objects, in shared memory, which does not change until it is released. */
typedef struct sweepd_sample sweepd_sample;

/* How a wait ended. */
typedef enum sweepd_next {
    SWEEPD_NEXT_RECEIVED = 0,
    SWEEPD_NEXT_TIMEOUT = 1,     /* nothing came within the limit */
    SWEEPD_NEXT_UNPUBLISHED = 2, /* the same, and nobody publishes it at present: sweepd_sensors says what there is */
    SWEEPD_NEXT_INTERRUPTED = 3, /* the program handled a signal, or was stopped and goes on (Ctrl-Z, fg): end if you are told to,
                                  * else wait again. A signal between two waits ends neither: give a limit, and look at your flag */
    SWEEPD_NEXT_INVALID = 4,     /* what came is no sweep, or no objects, of this layout: sweepd_error. The next may be */
    SWEEPD_NEXT_FAILED = 5       /* waiting does not mend it: sweepd_error says why, and how to mend it */
} sweepd_next;

/* What failed last on this thread: one line, "" where nothing did. Good until the next failure on this thread. */
const char *sweepd_error(void);

/* The sweeps of the sensor of this name, which need not be published yet. `root` is the daemon's folder; NULL is the default
 * one. NULL: sweepd_error. */
sweepd_client *sweepd_client_open(const char *sensor, const char *root);

/* The objects of the same sensor: another client. The daemon notices it within about a second. NULL: sweepd_error. */
sweepd_client *sweepd_client_objects(sweepd_client *client);

/* Waits for the next, and for the daemon if there is none; at most timeout_ns nanoseconds, without a limit where that is negative.
 * Gives a sweepd_next. `sample` is NULL unless one was received. Two of a client can be held at a time, sweeps or messages, and
 * with two held this fails; released, the next comes. A program that holds two, or is slow, misses sweeps and delays nobody. */
int32_t sweepd_client_next(sweepd_client *client, int64_t timeout_ns, sweepd_sample **sample);

/* 1: one waits, and sweepd_client_next would give it at once. */
int32_t sweepd_client_has_next(sweepd_client *client);

/* Where the bytes of a sample are, for sweepd_open or sweepd_objects_open: the memory that the daemon wrote, read-only.
 * Several threads may ask at once. */
const void *sweepd_sample_bytes(const sweepd_sample *sample, size_t *len);

/* Gives a sample back, on any thread, and even after its client was closed. */
void sweepd_sample_release(sweepd_sample *sample);

/* Sweeps of a run of the daemon that were published and did not come, between the first and the newest that did. 0 for objects:
 * first_ordinal of a message tells. */
uint64_t sweepd_client_missed(sweepd_client *client);

/* How often the service was lost, such as when its files were deleted, and searched again. */
uint64_t sweepd_client_reopened(sweepd_client *client);

/* 1: the service was found; even so, the daemon may be gone. */
int32_t sweepd_client_is_connected(sweepd_client *client);

/* 1: a daemon publishes it at present. */
int32_t sweepd_client_is_published(sweepd_client *client);

/* These two write as snprintf does: as much as fits into `capacity` bytes, with a zero at the end; they give the length of the
 * whole, without the zero. (NULL, 0) just asks for that. */

/* "model" of the sensor, "address" that its packets come from, or "schema", the version of the layout; SIZE_MAX where it is not
 * known, or not yet. */
size_t sweepd_client_attribute(sweepd_client *client, const char *key, char *text, size_t capacity);

/* Names of the sensors that are published on this host, one a line; SIZE_MAX: sweepd_error. */
size_t sweepd_sensors(const char *root, char *names, size_t capacity);

/* A box in the frame of the robot that stands on the floor (sweepd_floor_m): x right, y ahead, z up from the floor, metres. Where the
 * floor is not known, all that is over and under it counts. */
typedef struct sweepd_zone {
    double least_m[3];
    double most_m[3];
} sweepd_zone;

/* Fewest returns of an obstacle; 0 is taken as 1. */
typedef struct sweepd_least {
    uint32_t labelled;   /* of segments, of whichever, together */
    uint32_t unlabelled; /* without label, neighbours in the image and in range, two of a pixel once; more than 16 are taken as 16 */
} sweepd_least;

/* The nearest obstacle. */
typedef struct sweepd_obstacle {
    double distance_m; /* from the robot's origin to its nearest return, along the floor */
    uint32_t returns;  /* those of its label in the zone; without label, those in groups that are large enough */
    uint32_t label;    /* of its nearest return: 0, or of a segment */
} sweepd_obstacle;

/* Whether a way is free: 1, and the nearest obstacle in a zone, of the bytes of a sweep; 0: there is none; -1: sweepd_error. `least` may
 * be NULL: 3 and 4; `to` may be NULL. It allocates nothing. 0 does not mean that nothing is there: a low or thin thing may have no
 * return, and a sensor that does not see has SWEEPD_NOT_SEEING. Returns that a mask or the limits of range keep out of segments have no
 * label, and so can be an obstacle. The other return of a pixel is without label only where the segmented one is, too. */
int32_t sweepd_find_obstacle(const void *bytes, size_t len, const sweepd_zone *zone, const sweepd_least *least, sweepd_obstacle *to);

/* Ends a client, which no thread may use any more. Samples stay. */
void sweepd_client_close(sweepd_client *client);

#ifdef __cplusplus
}
#endif

#endif
