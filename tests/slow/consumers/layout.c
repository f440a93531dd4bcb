/* Says what sweepd.h makes of the layout; tests/slow/consumers/native.rs compares it with Rust.
 *
 *     layout points SWEEP       a record for each return
 *     layout points_in SWEEP START_NS X Y W  the points of all pixels, of a robot that moves so since then: metres a second,
 *                               radians a second clockwise
 *     layout check SWEEP        reads lines `offset value length shift`: the status of the sweep with that u32 in its header
 *     layout check_objects MESSAGE  the same of a message of objects
 *     layout objects MESSAGE    its header, its objects, its labels, and the box of each object in the frame of the robot
 */

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "sweepd.h"

/* One return, all in doubles but the time. */
struct record {
    double row, column, kind, label, reflectivity, range, azimuth, x, y, z;
    int64_t time_ns;
};

/* The whole file, at a multiple of 64, with so many bytes behind it and hardly more: what is read beyond them is seen. */
static uint8_t *content(const char *path, size_t *len, size_t more) {
    FILE *file = fopen(path, "rb");
    uint8_t *bytes;
    if (file == NULL || fseek(file, 0, SEEK_END) != 0) exit(2);
    *len = (size_t)ftell(file);
    rewind(file);
    bytes = (uint8_t *)malloc(*len + 64 + more);
    if (bytes == NULL) exit(2);
    bytes += 64 - (uintptr_t)bytes % 64;
    if (fread(bytes, 1, *len, file) != *len) exit(2);
    fclose(file);
    return bytes;
}

static void put(const sweepd_sweep *sweep, uint32_t row, uint32_t column, int other) {
    const size_t pixel = sweepd_pixel(sweep, row, column);
    const float range = other ? sweep->range2[pixel] : sweep->range[pixel];
    double xyz[3];
    struct record record;
    if (!sweepd_is_return(range)) return;
    sweepd_point_m(sweep, row, column, range, xyz);
    record.row = row;
    record.column = column;
    record.kind = sweepd_kind(sweep, row, column, other);
    record.label = other ? sweep->label2[pixel] : sweep->label[pixel];
    record.reflectivity = other ? sweep->reflectivity2[pixel] : sweep->reflectivity[pixel];
    record.range = (double)range;
    record.azimuth = sweepd_azimuth_rad(sweep, row, column);
    record.x = xyz[0];
    record.y = xyz[1];
    record.z = xyz[2];
    record.time_ns = sweepd_time_ns(sweep, row, column);
    fwrite(&record, sizeof record, 1, stdout);
}

static int points(const char *path) {
    size_t len;
    uint8_t *bytes = content(path, &len, 0);
    sweepd_sweep sweep;
    uint32_t row, column;
    if (sweepd_open(bytes, len, &sweep) != SWEEPD_OK) return 3;
    /* Whoever published it may write on: the copy is what counts. */
    memset(bytes, 0xA5, sizeof(sweepd_header));
    for (column = 0; column < sweep.columns_len; column++)
        for (row = 0; row < sweep.rows; row++) {
            put(&sweep, row, column, 0);
            if (sweep.range2 != NULL) put(&sweep, row, column, 1);
        }
    return 0;
}

/* A robot that moves evenly. */
struct motion {
    int64_t start_ns;
    double x, y, turn;
    sweepd_pose mount;
};

static sweepd_pose pose_at(int64_t time_ns, void *context) {
    const struct motion *motion = (const struct motion *)context;
    const double seconds = (double)(time_ns - motion->start_ns) * 1e-9;
    const double position[3] = {motion->x * seconds, motion->y * seconds, 0.0};
    const double quaternion[4] = {0.0, 0.0, sin(-motion->turn * seconds / 2.0), cos(motion->turn * seconds / 2.0)};
    const sweepd_pose robot = sweepd_pose_of(position, quaternion);
    return sweepd_chain(&robot, &motion->mount);
}

static int points_in(char **args) {
    static double xyz[1 << 19][3];
    size_t len;
    uint8_t *bytes = content(args[0], &len, 0);
    sweepd_sweep sweep;
    struct motion motion;
    if (sweepd_open(bytes, len, &sweep) != SWEEPD_OK) return 3;
    motion.start_ns = strtoll(args[1], NULL, 10);
    motion.x = atof(args[2]);
    motion.y = atof(args[3]);
    motion.turn = atof(args[4]);
    motion.mount = sweepd_mount(&sweep.header);
    sweepd_points_in(&sweep, sweep.range, pose_at, &motion, xyz);
    fwrite(xyz, sizeof xyz[0], (size_t)sweep.columns_len * sweep.rows, stdout);
    return 0;
}

static int objects(const char *path) {
    size_t len;
    uint8_t *bytes = content(path, &len, 0);
    sweepd_objects view;
    sweepd_pose mount;
    uint32_t at;
    if (sweepd_objects_open(bytes, len, &view) != SWEEPD_OK) return 3;
    memset(bytes, 0xA5, sizeof(sweepd_objects_header));
    fwrite(&view.header, sizeof view.header, 1, stdout);
    fwrite(view.objects, sizeof(sweepd_object), view.objects_len, stdout);
    fwrite(view.labels, sizeof(uint32_t), view.labels_len, stdout);
    mount = sweepd_objects_mount(&view.header);
    for (at = 0; at < view.objects_len; at++) {
        double bounds_m[2][3];
        sweepd_bounds(&mount, &view.objects[at].segment, bounds_m);
        fwrite(bounds_m, sizeof bounds_m, 1, stdout);
    }
    return 0;
}

static sweepd_status check_objects(const void *bytes, size_t len) {
    sweepd_objects view;
    return sweepd_objects_open(bytes, len, &view);
}

static int check(const char *path, sweepd_status (*status_of)(const void *, size_t)) {
    size_t len;
    uint8_t *bytes = content(path, &len, 64);
    uint32_t at, value, cut, shift, before;
    while (scanf("%" SCNu32 " %" SCNu32 " %" SCNu32 " %" SCNu32, &at, &value, &cut, &shift) == 4) {
        memcpy(&before, bytes + at, 4);
        memcpy(bytes + at, &value, 4);
        memmove(bytes + shift, bytes, cut);
        printf("%d\n", (int)status_of(bytes + shift, cut));
        memmove(bytes, bytes + shift, cut);
        memcpy(bytes + at, &before, 4);
    }
    return 0;
}

int main(int argc, char **argv) {
    if (argc == 3 && strcmp(argv[1], "points") == 0) return points(argv[2]);
    if (argc == 7 && strcmp(argv[1], "points_in") == 0) return points_in(argv + 2);
    if (argc == 3 && strcmp(argv[1], "check") == 0) return check(argv[2], sweepd_check);
    if (argc == 3 && strcmp(argv[1], "check_objects") == 0) return check(argv[2], check_objects);
    if (argc == 3 && strcmp(argv[1], "objects") == 0) return objects(argv[2]);
    return 1;
}
