/* Drives the firmware by what it reads, for the sanitizers: after the numbers of the limits, an operation a byte each time. */
#include "glove_device.h"

#include <stdio.h>

static uint32_t number(void) {
    uint32_t found = 0;
    for (int k = 0; k < 4; k++) found = found << 8 | (uint32_t)(getchar() & 255);
    return found;
}

int main(void) {
    struct glove_device device;
    struct glove_limits limits;
    uint8_t line[GLOVE_LINE];
    uint32_t now, sum = 0;
    int operation;
    limits.channels = (uint8_t)number();
    for (int k = 0; k < GLOVE_CHANNELS; k++) limits.most[k] = (int16_t)number();
    for (int k = 0; k < GLOVE_CHANNELS; k++) limits.continuous[k] = (int16_t)number();
    limits.heating = (uint16_t)number();
    limits.slew = (uint16_t)number();
    limits.quantum = (uint16_t)number();
    limits.watchdog = (uint16_t)number();
    limits.seed = number();
    limits.vibrators = (uint8_t)number();
    limits.heaters = (uint8_t)number();
    limits.resting = (uint16_t)number();
    limits.heat_rise = (uint16_t)number();
    limits.heat_time = (uint16_t)number();
    now = number();
    glove_init(&device, limits);
    while ((operation = getchar()) != EOF) {
        switch (operation & 7) {
        case 0: now += (uint32_t)(operation >> 3) * 1000u; break;
        case 1: now += number(); break;
        case 2: glove_trip(&device, (enum glove_cause)(operation >> 3 & 3)); break;
        case 3: glove_press(&device, operation >> 3 == 1); break;
        case 4: glove_status(&device, now, line); glove_skin(&device, now, line); break;
        case 5: while (glove_answer(&device, now, line)) sum += line[1]; break;
        default:
            for (int left = getchar() & 63; left > 0 && (operation = getchar()) != EOF; left--)
                glove_receive(&device, now, (uint8_t)operation);
        }
        glove_step(&device, now);
        for (int k = 0; k < GLOVE_CHANNELS; k++)
            if (device.counts[k] < 0 || device.counts[k] > device.limits.most[k]) return 2;
        if (device.state != GLOVE_ARMED)
            for (int k = 0; k < GLOVE_CHANNELS; k++)
                if (device.counts[k]) return 3;
        for (int k = 0; k < GLOVE_FINGERS; k++)
            if (device.amplitudes[k] < 0 || device.amplitudes[k] > 1000) return 5;
        if (device.state == GLOVE_LATCHED && (device.heating || device.amplitudes[0])) return 6;
        if (device.state == GLOVE_ARMED && ++sum == 0) return 4;
    }
    printf("%u\n", (unsigned)(device.accepted + device.stale + device.refused));
    return 0;
}
