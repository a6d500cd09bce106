/* What start.c offers a bare-metal program: output, exit, a clock, and the limits of the stack. */
#ifndef IMAGE_START_H
#define IMAGE_START_H

#include <stdint.h>

#define IMAGE_TIMER 0x40000000u /* CMSDK timer 0 of the boards mps2-an385, an386 and an500 */
#define IMAGE_UART 0x40004000u /* CMSDK UART 0 */

extern uint32_t image_stack_limit[], image_stack_top[]; /* of the linker script */

int main(void);
void image_tick(void); /* of the program, if it starts the SysTick timer */
void image_put(char c);
void image_exit(int code) __attribute__((noreturn));

/* Ticks of the board's timer, which counts down from 2^32 - 1. */
static inline uint32_t image_clock(void)
{
    return 0xFFFFFFFFu - *(volatile uint32_t *)(IMAGE_TIMER + 0x04u);
}

#endif
