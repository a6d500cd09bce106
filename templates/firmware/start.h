/* Functions of start.c for a bare-metal program: output, exit, a clock, and the limits of the stack. */
#ifndef IMAGE_START_H
#define IMAGE_START_H

#include <stdint.h>

extern uint32_t image_stack_limit[], image_stack_top[]; /* defined by the linker script */

int main(void);
void image_tick(void); /* defined by the program if it starts the SysTick timer of a Cortex-M */
void image_put(char c);
void image_exit(int code) __attribute__((noreturn));

#if defined(__riscv)
#define IMAGE_MOVE "mv"

/* Returns the number of instructions so far. */
static inline uint32_t image_clock(void)
{
    uint32_t count;
    __asm volatile(".insn i 0x73, 2, %0, x0, -0x4FE" : "=r"(count) : : "memory"); /* csrr %0, minstret */
    return count;
}
#else
#define IMAGE_MOVE "mov"
#define IMAGE_TIMER 0x40000000u /* CMSDK timer 0 of the boards mps2-an385, an386 and an500 */
#define IMAGE_UART 0x40004000u /* CMSDK UART 0 */

/* Returns the ticks of the board's timer, which counts down from 2^32 - 1. */
static inline uint32_t image_clock(void)
{
    return 0xFFFFFFFFu - *(volatile uint32_t *)(IMAGE_TIMER + 0x04u);
}
#endif

static inline __attribute__((always_inline)) uint32_t *image_stack_pointer(void)
{
    uint32_t *sp;
    __asm volatile(IMAGE_MOVE " %0, sp" : "=r"(sp) : : "memory");
    return sp;
}

#endif
