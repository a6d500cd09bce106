/* Start and exit of a bare-metal program on a 32-bit RISC-V core: memory, UART. Contract: the linker script defines the
 * image_* symbols; the program defines main(). image_put() writes a character to the UART of the board "virt",
 * image_exit() ends the emulation. Replace these two functions on another chip. */
#include "start.h"

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART ((volatile uint8_t *)0x10000000u)
#define UART_STATE 5
#define UART_READY 0x20u
#define FINISHER REGISTER(0x00100000u)
#define FINISHED 0x5555u
#define FAILED 0x3333u

extern uint32_t image_data_load[], image_data_begin[], image_data_end[], image_bss_begin[], image_bss_end[];
void image_begin(void);
void image_fault(void);

void image_put(char c)
{
    while ((UART[UART_STATE] & UART_READY) == 0u) {}
    UART[0] = (uint8_t)c;
}

void image_exit(int code)
{
    FINISHER = (code == 0) ? FINISHED : (((uint32_t)code << 16) | FAILED);
    for (;;) {}
}

/* Handles exceptions. */
__attribute__((aligned(4))) void image_fault(void)
{
    for (const char *c = "fault\n"; *c != '\0'; c++) {
        image_put(*c);
    }
    image_exit(70);
}

void image_begin(void)
{
    const uint32_t *from = image_data_load;
    for (uint32_t *to = image_data_begin; to < image_data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = image_bss_begin; to < image_bss_end; to++) {
        *to = 0u;
    }
    image_exit(main());
}

/* The first instructions set the stack, copy the data and set the exception handler, on the only hardware thread.
 * Assemblers that want an extension of -march for "csrw mtvec, t0" accept its encoding. */
__attribute__((section(".vectors"), naked, used)) void image_start(void)
{
    __asm volatile("la sp, image_stack_top\n\t"
                   "la tp, image_thread\n\t"
                   "la t0, image_fault\n\t"
                   ".insn i 0x73, 1, x0, t0, 0x305\n\t"
                   "j image_begin");
}
