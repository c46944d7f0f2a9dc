#include "glove_device.h"

#include <string.h>

#define WINDOW 64u
#define LONGEST_SILENCE 1000000u
#define LONGEST_STEP 20000u
#define LONGEST_COOLING 8000u /* ms in one step, so that 64 bits hold every product below */
#define FADING 5u             /* the last fifth of a motor's warmth, over which its largest count fades */
#define ANSWERS 3u
#define LARGEST_AMPLITUDE 1000
#define LARGEST_RISE 20000u
#define BODY 40
#define VALUES 12

static uint32_t crc32(const uint8_t *data, size_t size) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static uint16_t get16(const uint8_t *at) { return (uint16_t)(at[0] | at[1] << 8); }
static uint32_t get32(const uint8_t *at) { return get16(at) | (uint32_t)get16(at + 2) << 16; }
static void put16(uint8_t *at, uint16_t value) { at[0] = (uint8_t)value; at[1] = (uint8_t)(value >> 8); }
static void put32(uint8_t *at, uint32_t value) { put16(at, (uint16_t)value); put16(at + 2, (uint16_t)(value >> 16)); }

/* A frame has 44 bytes, so that no run is as long as 254 and every code byte but the first stands for a zero. */
static void stuff(const uint8_t data[GLOVE_FRAME], uint8_t line[GLOVE_LINE]) {
    size_t code = 0;
    for (size_t i = 0; i < GLOVE_FRAME; i++) {
        line[i + 1] = data[i];
        if (data[i] == 0) {
            line[code] = (uint8_t)(i + 1 - code);
            code = i + 1;
        }
    }
    line[code] = (uint8_t)(GLOVE_LINE - 1 - code);
    line[GLOVE_LINE - 1] = 0;
}

static bool unstuff(const uint8_t *line, size_t length, uint8_t data[GLOVE_FRAME]) {
    if (length != GLOVE_LINE - 1) return false;
    size_t code = 0;
    while (code < length) {
        size_t next = code + line[code];
        if (next > length) return false;
        if (code > 0) data[code - 1] = 0;
        memcpy(data + code, line + code + 1, next - code - 1);
        code = next;
    }
    return true;
}

static void drop(struct glove_device *device) {
    memset(device->counts, 0, sizeof device->counts);
    memset(device->wanted, 0, sizeof device->wanted);
    device->credit = 0;
}

/* Vibration silent, heaters off. */
static void hush(struct glove_device *device) {
    memset(device->amplitudes, 0, sizeof device->amplitudes);
    memset(device->targets, 0, sizeof device->targets);
    device->heating = 0;
}

void glove_init(struct glove_device *device, struct glove_limits limits) {
    memset(device, 0, sizeof *device);
    if (limits.channels > GLOVE_CHANNELS) limits.channels = GLOVE_CHANNELS;
    for (int k = 0; k < GLOVE_CHANNELS; k++) {
        if (k >= limits.channels || limits.most[k] < 0) limits.most[k] = 0;
        if (limits.continuous[k] <= 0 || limits.continuous[k] > limits.most[k]) limits.continuous[k] = limits.most[k];
    }
    if (limits.vibrators > GLOVE_FINGERS) limits.vibrators = GLOVE_FINGERS;
    if (limits.heaters > GLOVE_FINGERS) limits.heaters = GLOVE_FINGERS;
    if (limits.heat_rise > LARGEST_RISE) limits.heat_rise = LARGEST_RISE;
    /* Without the numbers of a heater there is none. */
    if (!limits.heat_rise || !limits.heat_time || limits.resting > GLOVE_HOTTEST) limits.heaters = 0;
    device->limits = limits;
}

void glove_trip(struct glove_device *device, enum glove_cause cause) {
    if (device->state == GLOVE_ARMED || cause == GLOVE_OWN || cause == GLOVE_STOPPED) {
        device->state = GLOVE_LATCHED;
        device->cause = cause;
    }
    drop(device);
    if (device->state == GLOVE_LATCHED) hush(device);
}

void glove_press(struct glove_device *device, bool pressed) {
    device->pressed = pressed;
    if (pressed) glove_trip(device, GLOVE_STOPPED);
}

void glove_feel(struct glove_device *device, uint8_t heater, int16_t temperature) {
    if (heater < device->limits.heaters) device->measured[heater] = temperature;
}

/* Another number that ARM must repeat, good for one. */
static void draw(struct glove_device *device, uint32_t now) {
    uint8_t from[12];
    put32(from, device->limits.seed);
    put32(from + 4, now);
    put32(from + 8, ++device->drawn);
    device->nonce = (int16_t)(uint16_t)crc32(from, sizeof from);
}

static void greet(struct glove_device *device, uint32_t now, const uint8_t *data) {
    if (device->state == GLOVE_ARMED) glove_trip(device, GLOVE_GREETED);
    device->newest = get16(data + 2);
    device->peer_clock = get32(data + 4);
    device->session = (int16_t)get16(data + VALUES);
    device->accepted = device->missing = device->stale = 0;
    device->greeted = true;
    device->answers = ANSWERS;
    device->sensed = false;
    hush(device);
    draw(device, now);
}

/* Newer than the last by clock and by number: what an older session left on the line is neither. */
static bool is_new(struct glove_device *device, const uint8_t *data) {
    uint32_t later = get32(data + 4) - device->peer_clock;
    uint16_t ahead = (uint16_t)(get16(data + 2) - device->newest);
    if (later == 0 || later > LONGEST_SILENCE || ahead == 0 || ahead > WINDOW) {
        device->stale++;
        return false;
    }
    device->missing += ahead - 1u;
    device->newest = get16(data + 2);
    device->peer_clock = get32(data + 4);
    return true;
}

/* Torque ends whatever the frame's age; it begins and goes on only by what answers a frame of ours in time. */
static void obey(struct glove_device *device, uint32_t now, const uint8_t *data) {
    uint32_t echo = get32(data + 8);
    bool arms = (data[0] & 15) == GLOVE_ARM;
    if (!arms && !(data[1] & GLOVE_ENABLE)) {
        device->accepted++;
        if (device->state == GLOVE_ARMED) device->state = GLOVE_IDLE;
        drop(device);
        return;
    }
    if (now - echo > (uint32_t)1000 * device->limits.watchdog) {
        device->stale++;
        return;
    }
    device->accepted++;
    if (arms) {
        if ((int16_t)get16(data + VALUES) != device->session) return;
        if ((int16_t)get16(data + VALUES + 2) != device->nonce || device->pressed) return;
        drop(device);
        device->state = GLOVE_ARMED;
        device->cause = GLOVE_NO_CAUSE;
        device->heard = echo;
        draw(device, now);
    } else if (device->state == GLOVE_ARMED) {
        device->heard = echo;
        for (int k = 0; k < GLOVE_CHANNELS; k++) {
            int16_t value = (int16_t)get16(data + VALUES + 2 * k), most = device->limits.most[k];
            device->wanted[k] = value < 0 ? 0 : value > most ? most : value;
        }
    }
}

/* Vibration and heat go on only by what answers a frame of ours in time, each by its own watchdog. */
static void sense(struct glove_device *device, uint32_t now, const uint8_t *data) {
    uint32_t echo = get32(data + 8);
    bool heats = (data[0] & 15) == GLOVE_HEAT;
    int count = heats ? device->limits.heaters : device->limits.vibrators;
    int16_t most = heats ? GLOVE_HOTTEST : LARGEST_AMPLITUDE;
    int16_t *values = heats ? device->targets : device->amplitudes;
    if (now - echo > (heats ? 1000u * GLOVE_HEAT_WATCHDOG : 1000u * GLOVE_VIBRATION_WATCHDOG)) {
        device->stale++;
        return;
    }
    device->accepted++;
    device->sensed = true;
    if (device->state == GLOVE_LATCHED) return;
    if (heats) device->heat_heard = echo;
    else device->vibration_heard = echo;
    for (int k = 0; k < GLOVE_FINGERS; k++) {
        int16_t value = (int16_t)get16(data + VALUES + 2 * k);
        values[k] = k >= count || value < 0 ? 0 : value > most ? most : value;
    }
}

static void handle(struct glove_device *device, uint32_t now) {
    uint8_t data[GLOVE_FRAME];
    uint8_t kind;
    bool good = !device->overflown && unstuff(device->kept, device->length, data) &&
                crc32(data, BODY) == get32(data + BODY) && data[0] >> 4 == GLOVE_VERSION;
    kind = good ? data[0] & 15 : 0;
    if (kind < GLOVE_HELLO || kind > GLOVE_SKIN) {
        device->refused++;
    } else if (kind == GLOVE_HELLO) {
        greet(device, now, data);
    } else if ((kind == GLOVE_COMMAND || kind == GLOVE_ARM) && device->greeted && is_new(device, data)) {
        obey(device, now, data);
    } else if ((kind == GLOVE_VIBRATE || kind == GLOVE_HEAT) && device->greeted && is_new(device, data)) {
        sense(device, now, data);
    } else if (kind == GLOVE_STOP) {
        /* Whatever its age: an old one can do no harm. */
        glove_trip(device, GLOVE_STOPPED);
        if (device->greeted && is_new(device, data)) device->accepted++;
    }
}

void glove_receive(struct glove_device *device, uint32_t now, uint8_t byte) {
    if (byte != 0) {
        /* More than a frame is none, however it goes on: only a zero begins another. */
        if (device->length == GLOVE_LINE) device->overflown = true;
        else device->kept[device->length++] = byte;
        return;
    }
    if (device->length > 0) handle(device, now);
    device->length = 0;
    device->overflown = false;
}

/* Motors warm with the square of what they held since the last step, and cool, in whole milliseconds. What is taken up
 * now cools from the next step on, so that rounding and long steps make it no less than it is. */
static uint64_t warm(struct glove_device *device, uint32_t passed) {
    uint64_t total = (uint64_t)device->warmed + passed, time = total / 1000u;
    uint64_t constant = (uint64_t)device->limits.heating * 10u;
    device->warmed = (uint32_t)(total % 1000u);
    if (time > LONGEST_COOLING) time = LONGEST_COOLING;
    if (time == 0) return 0;
    for (int k = 0; k < GLOVE_CHANNELS; k++) {
        uint64_t heat = (uint64_t)((int32_t)device->counts[k] * device->counts[k]);
        device->warmth[k] -= device->warmth[k] * time / (constant + time);
        device->warmth[k] += heat * time;
    }
    return time;
}

/* A rise of temperature after `time` ms of heating from cold, rounded up [1/100,000 deg C]. */
static uint64_t heated(const struct glove_device *device, uint64_t time) {
    uint64_t constant = (uint64_t)device->limits.heat_time * 10u;
    return ((uint64_t)device->limits.heat_rise * 1000u * time + constant - 1u) / constant;
}

/* A temperature at a rise, rounded up [1/100 deg C]. */
static int32_t reached(const struct glove_device *device, uint64_t rise) {
    return (int32_t)(device->limits.resting + (rise + 999u) / 1000u);
}

/* Temperatures by an estimate that is never too low, both watchdogs, and then the heaters: on only where even the
 * longest step from here stays below the target. */
static void step_skin(struct glove_device *device, uint32_t now, uint64_t time) {
    uint64_t constant = (uint64_t)device->limits.heat_time * 10u;
    uint8_t heating = 0;
    for (int k = 0; k < device->limits.heaters; k++) {
        device->rises[k] -= device->rises[k] * time / (constant + time);
        if (device->heating >> k & 1) device->rises[k] += heated(device, time);
    }
    if (now - device->vibration_heard > 1000u * GLOVE_VIBRATION_WATCHDOG)
        memset(device->amplitudes, 0, sizeof device->amplitudes);
    if (now - device->heat_heard > 1000u * GLOVE_HEAT_WATCHDOG) memset(device->targets, 0, sizeof device->targets);
    for (int k = 0; k < device->limits.heaters; k++) {
        uint64_t next = device->rises[k] + heated(device, LONGEST_STEP / 1000u);
        int16_t target = device->targets[k];
        if (target > 0 && reached(device, next) <= target && device->measured[k] < target)
            heating = (uint8_t)(heating | 1 << k);
    }
    device->heating = heating;
}

/* What a motor bears for ever [counts^2 ms]. */
static uint64_t bearable(const struct glove_device *device, int k) {
    uint64_t lasting = (uint64_t)device->limits.continuous[k];
    return lasting * lasting * device->limits.heating * 10u;
}

/* The largest count of a channel, by how warm its motor is. */
static int16_t allowed(const struct glove_device *device, int k) {
    int16_t most = device->limits.most[k], lasting = device->limits.continuous[k];
    uint64_t bears = bearable(device, k), fades = bears / FADING;
    uint64_t left = bears > device->warmth[k] ? bears - device->warmth[k] : 0;
    if (left >= fades) return most;
    return (int16_t)(lasting + (int16_t)((uint64_t)(most - lasting) * left / fades));
}

void glove_step(struct glove_device *device, uint32_t now) {
    uint32_t passed = now - device->stepped;
    int32_t step;
    device->stepped = now;
    step_skin(device, now, warm(device, passed));
    if (passed > LONGEST_STEP) passed = LONGEST_STEP;
    if (device->state == GLOVE_ARMED && now - device->heard > (uint32_t)1000 * device->limits.watchdog)
        glove_trip(device, GLOVE_WATCHDOG);
    if (device->state != GLOVE_ARMED) {
        drop(device);
        return;
    }
    /* Whole counts, and what is left of one is kept, so that no clock makes it faster or slower. */
    device->credit += (uint32_t)device->limits.slew * passed;
    step = (int32_t)(device->credit / 1000u);
    device->credit %= 1000u;
    for (int k = 0; k < GLOVE_CHANNELS; k++) {
        int16_t most = allowed(device, k);
        int32_t change = (int32_t)device->wanted[k] - device->counts[k];
        change = change > step ? step : change < -step ? -step : change;
        device->counts[k] = (int16_t)(device->counts[k] + change);
        if (device->counts[k] > most) device->counts[k] = most;
    }
}

void glove_frame(struct glove_device *device, uint32_t now, enum glove_kind kind,
                 const int16_t values[GLOVE_CHANNELS], uint8_t flags, uint8_t line[GLOVE_LINE]) {
    uint8_t data[GLOVE_FRAME];
    if (device->state == GLOVE_ARMED) flags |= GLOVE_ENABLE;
    if (device->state == GLOVE_LATCHED) flags |= GLOVE_LATCHED_FLAG;
    if (device->pressed) flags |= GLOVE_PRESSED;
    data[0] = (uint8_t)(GLOVE_VERSION << 4 | kind);
    data[1] = (uint8_t)(flags | device->cause << 4);
    put16(data + 2, ++device->sent);
    put32(data + 4, now);
    put32(data + 8, device->peer_clock);
    for (int k = 0; k < GLOVE_CHANNELS; k++) put16(data + VALUES + 2 * k, (uint16_t)values[k]);
    put32(data + BODY, crc32(data, BODY));
    stuff(data, line);
}

bool glove_answer(struct glove_device *device, uint32_t now, uint8_t line[GLOVE_LINE]) {
    int16_t values[GLOVE_CHANNELS] = {0};
    if (!device->answers) return false;
    if (--device->answers < ANSWERS - 1) {
        bool last = !device->answers;
        glove_frame(device, now, last ? GLOVE_CONTINUOUS : GLOVE_LIMITS,
                    last ? device->limits.continuous : device->limits.most, 0, line);
        return true;
    }
    values[0] = device->session;
    values[1] = device->limits.channels;
    values[2] = (int16_t)device->limits.watchdog;
    values[3] = (int16_t)device->limits.quantum;
    for (int k = 0; k < GLOVE_CHANNELS; k++)
        if (device->limits.most[k] > values[4]) values[4] = device->limits.most[k];
    values[5] = (int16_t)device->limits.slew;
    values[6] = device->nonce;
    values[7] = (int16_t)device->limits.heating;
    values[8] = device->limits.vibrators;
    values[9] = device->limits.vibrators ? GLOVE_VIBRATION_WATCHDOG : 0;
    values[10] = device->limits.heaters;
    values[11] = device->limits.heaters ? GLOVE_HEAT_WATCHDOG : 0;
    values[12] = device->limits.heaters ? GLOVE_HOTTEST : 0;
    glove_frame(device, now, GLOVE_CAPABILITY, values, 0, line);
    return true;
}

/* A motor's warmth [1/1000 of what it bears for ever]. */
static int16_t share(const struct glove_device *device, int k) {
    uint64_t bears = bearable(device, k);
    uint64_t found = device->warmth[k] * 1000u / (bears ? bears : 1);
    return (int16_t)(found < 32767u ? found : 32767u);
}

void glove_status(struct glove_device *device, uint32_t now, uint8_t line[GLOVE_LINE]) {
    const uint32_t numbers[4] = {device->accepted, device->missing, device->stale, device->refused};
    int16_t values[GLOVE_CHANNELS] = {device->session, (int16_t)device->state, (int16_t)device->cause};
    for (int k = 0; k < 4; k++) {
        values[3 + 2 * k] = (int16_t)(uint16_t)numbers[k];
        values[4 + 2 * k] = (int16_t)(uint16_t)(numbers[k] >> 16);
    }
    values[11] = (int16_t)device->newest;
    values[12] = device->told;
    values[13] = share(device, device->told);
    if (++device->told >= device->limits.channels) device->told = 0;
    glove_frame(device, now, GLOVE_STATUS, values, 0, line);
}

void glove_skin(struct glove_device *device, uint32_t now, uint8_t line[GLOVE_LINE]) {
    int16_t values[GLOVE_CHANNELS] = {0};
    for (int k = 0; k < GLOVE_FINGERS; k++) values[k] = device->amplitudes[k];
    for (int k = 0; k < device->limits.heaters; k++) {
        int32_t value = reached(device, device->rises[k]);
        if (device->measured[k] > value) value = device->measured[k];
        values[GLOVE_FINGERS + k] = (int16_t)(value < 32767 ? value : 32767);
    }
    values[2 * GLOVE_FINGERS] = device->heating;
    glove_frame(device, now, GLOVE_SKIN, values, 0, line);
}
