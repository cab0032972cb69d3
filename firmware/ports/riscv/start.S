/* QEMU's virt machine, hart 0: a stack, an empty bss, the trap's address, and main. */
    .section .init
    .globl _start
_start:
    la sp, stack_top
    la t0, bss_begin
    la t1, bss_end
1:  bgeu t0, t1, 2f
    sw zero, 0(t0)
    addi t0, t0, 4
    j 1b
2:  la t0, trap
    csrw mtvec, t0
    call main
3:  j 3b

/* Semihosting: these three, uncompressed and in one page, are the call. */
    .section .text
    .globl semihost
    .balign 16
    .option push
    .option norvc
semihost:
    slli zero, zero, 0x1f
    ebreak
    srai zero, zero, 7
    ret
    .option pop
