/* Reference of the native protocol for a microcontroller: C99, no allocation, no floating point.
 * PROTOCOL.md beside it says what it does; device.py is its twin, and the tests hold both to the same answers.
 *
 * Call glove_receive for each byte that the line brings, glove_step about every millisecond, and drive the motors by
 * `counts` after each step. Times are a free-running clock in microseconds that may wrap, and none is before the last
 * one given: one that is counts as a wrap, and latches. All calls come from one context, or with interrupts off. Call
 * glove_press with what the line of the emergency stop's button says, at each step or when it changes; a button that
 * cannot wait for that cuts the motors' power itself.
 */
#ifndef GLOVE_DEVICE_H
#define GLOVE_DEVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define GLOVE_VERSION 2
#define GLOVE_CHANNELS 14
#define GLOVE_FINGERS 5  /* vibration channels, and heat channels, at most: a finger each, thumb first */
#define GLOVE_VIBRATION_WATCHDOG 50 /* [ms] */
#define GLOVE_HEAT_WATCHDOG 250     /* [ms] */
#define GLOVE_HOTTEST 4200          /* bound of a temperature [1/100 deg C]; nothing raises it */
#define GLOVE_FRAME 44   /* bytes of a frame before stuffing */
#define GLOVE_LINE 46    /* bytes of a frame on the line, the zero at its end among them */

enum glove_kind {
    GLOVE_HELLO = 1,
    GLOVE_CAPABILITY = 2,
    GLOVE_COMMAND = 3,
    GLOVE_ANGLES = 4,
    GLOVE_TENSIONS = 5,
    GLOVE_ARM = 6,
    GLOVE_STATUS = 7,
    GLOVE_STOP = 8,
    GLOVE_LIMITS = 9,
    GLOVE_CONTINUOUS = 10,
    GLOVE_VIBRATE = 11,
    GLOVE_HEAT = 12,
    GLOVE_SKIN = 13
};
enum glove_flag { GLOVE_ENABLE = 1, GLOVE_LATCHED_FLAG = 2, GLOVE_SATURATED = 4, GLOVE_PRESSED = 8 };
enum glove_state { GLOVE_IDLE = 0, GLOVE_ARMED = 1, GLOVE_LATCHED = 2 };
enum glove_cause {
    GLOVE_NO_CAUSE = 0,
    GLOVE_WATCHDOG = 1,
    GLOVE_GREETED = 2,
    GLOVE_OWN = 3,
    GLOVE_STOPPED = 4
};

/* What the motors and the line allow: set before glove_init. */
struct glove_limits {
    uint8_t channels;      /* 14 at most */
    int16_t most[GLOVE_CHANNELS];        /* largest counts, by channel */
    int16_t continuous[GLOVE_CHANNELS];  /* those that a motor bears for ever; 0 for as much as the largest */
    uint16_t heating;      /* time constant by which motors warm and cool [10 ms]; 0 for none that warm */
    uint16_t slew;         /* largest change [counts/ms] */
    uint16_t quantum;      /* torque of a count [1e-7 N.m] */
    uint16_t watchdog;     /* time after which it latches, from when it sent what the newest command answers [ms] */
    uint32_t seed;         /* another each time it is switched on, such as noise of its sensors */
    uint8_t vibrators;     /* vibration channels; 0 for none */
    uint8_t heaters;       /* heat channels; 0 for none */
    uint16_t resting;      /* temperature of the skin under a heater that is off [1/100 deg C] */
    uint16_t heat_rise;    /* its rise under a heater that is on for ever [1/100 deg C], at least the true one */
    uint16_t heat_time;    /* time constant of that rise [10 ms], at most the true one */
};

struct glove_device {
    struct glove_limits limits;
    enum glove_state state;
    enum glove_cause cause;
    int16_t counts[GLOVE_CHANNELS];   /* what the motors are to hold */
    uint32_t accepted, missing, stale, refused;
    int16_t amplitudes[GLOVE_FINGERS]; /* of the vibrators [1/1000] */
    uint8_t heating;                   /* heaters to be on, a bit each; off unless glove_step says so again in 20 ms */
    bool sensed;                       /* the host uses these channels: send glove_skin ten times a second */

    /* The rest is its own. */
    int16_t wanted[GLOVE_CHANNELS];
    uint8_t kept[GLOVE_LINE];
    size_t length;
    bool overflown, greeted, pressed;
    uint8_t answers, told;            /* frames still owed to a HELLO; channel whose warmth STATUS says next */
    uint64_t warmth[GLOVE_CHANNELS];  /* taken up and not yet given off [counts^2 ms] */
    uint32_t warmed;
    int16_t session, nonce;
    uint32_t drawn;
    uint16_t newest, sent;
    uint32_t peer_clock, heard, stepped, credit;
    int16_t targets[GLOVE_FINGERS], measured[GLOVE_FINGERS];
    uint64_t rises[GLOVE_FINGERS];    /* of the temperatures [1/100,000 deg C] */
    uint32_t vibration_heard, heat_heard;
};

void glove_init(struct glove_device *device, struct glove_limits limits);
void glove_receive(struct glove_device *device, uint32_t now, uint8_t byte);
void glove_step(struct glove_device *device, uint32_t now);
void glove_trip(struct glove_device *device, enum glove_cause cause);
void glove_press(struct glove_device *device, bool pressed);
/* The temperature that a sensor at a heat channel measures [1/100 deg C]; 0 without one. */
void glove_feel(struct glove_device *device, uint8_t heater, int16_t temperature);

/* A frame to send, numbered and with the device's state among its flags; `line` holds GLOVE_LINE bytes. */
void glove_frame(struct glove_device *device, uint32_t now, enum glove_kind kind,
                 const int16_t values[GLOVE_CHANNELS], uint8_t flags, uint8_t line[GLOVE_LINE]);
/* What is left of the answer to a HELLO: CAPABILITY, LIMITS, CONTINUOUS; false where nothing is. */
bool glove_answer(struct glove_device *device, uint32_t now, uint8_t line[GLOVE_LINE]);
void glove_status(struct glove_device *device, uint32_t now, uint8_t line[GLOVE_LINE]);
void glove_skin(struct glove_device *device, uint32_t now, uint8_t line[GLOVE_LINE]);

#endif
