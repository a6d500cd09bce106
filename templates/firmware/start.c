/* Start and exit of a bare-metal program on a Cortex-M: vector table, memory, floating-point unit, UART. Contract: the
 * linker script defines the image_* symbols; the program defines main(). image_put() writes a character to the UART of
 * the board, image_exit() ends the emulation by semihosting. Replace these two functions on another chip. */
#include "start.h"

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define COPROCESSOR_ACCESS REGISTER(0xE000ED88u)
#define UART_DATA REGISTER(IMAGE_UART)
#define UART_STATE REGISTER(IMAGE_UART + 0x04u)
#define UART_CONTROL REGISTER(IMAGE_UART + 0x08u)
#define UART_DIVIDER REGISTER(IMAGE_UART + 0x10u)
#define TIMER_CONTROL REGISTER(IMAGE_TIMER)
#define TIMER_RELOAD REGISTER(IMAGE_TIMER + 0x08u)

extern uint32_t image_data_load[], image_data_begin[], image_data_end[], image_bss_begin[], image_bss_end[];
void image_start(void);
static void image_fault(void);
void image_tick(void) __attribute__((weak));

typedef void (*handler_t)(void);

/* Handles SysTick: calls image_tick(), if the program defines it. */
static void image_systick(void)
{
    if (image_tick != 0) {
        image_tick();
    } else {
        image_fault();
    }
}

/* Initial stack pointer, reset, the exceptions that a program can raise, and SysTick. */
__attribute__((section(".vectors"), used)) static const handler_t vectors[16] = {(handler_t)image_stack_top,
    image_start, image_fault, image_fault, image_fault, image_fault, image_fault, 0, 0, 0, 0, image_fault, image_fault,
    0, image_fault, image_systick};

void image_put(char c)
{
    while ((UART_STATE & 1u) != 0u) {}
    UART_DATA = (uint32_t)(unsigned char)c;
}

/* Exits by SYS_EXIT_EXTENDED with the reason ADP_Stopped_ApplicationExit and the exit code. */
void image_exit(int code)
{
    const uint32_t block[2] = {0x20026u, (uint32_t)code};
    __asm volatile("mov r0, #0x20\n\tmov r1, %0\n\tbkpt 0xAB" : : "r"(block) : "r0", "r1", "memory");
    for (;;) {}
}

static void image_fault(void)
{
    for (const char *c = "fault\n"; *c != '\0'; c++) {
        image_put(*c);
    }
    image_exit(70);
}

void image_start(void)
{
#if defined(__ARM_FP)
    COPROCESSOR_ACCESS = COPROCESSOR_ACCESS | (0xFu << 20);
    __asm volatile("dsb\n\tisb" : : : "memory");
#endif
    const uint32_t *from = image_data_load;
    for (uint32_t *to = image_data_begin; to < image_data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = image_bss_begin; to < image_bss_end; to++) {
        *to = 0u;
    }
    UART_DIVIDER = 16u;
    UART_CONTROL = 1u;
    TIMER_RELOAD = 0xFFFFFFFFu;
    TIMER_CONTROL = 1u;
    image_exit(main());
}
