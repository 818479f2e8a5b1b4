/* An Arduino Nano in simavr with an emulated HX711 amplifier on the pins D2 (clock) and D3 (data).

   usage: hx711_board FIRMWARE.elf

   It prints the path of a pseudo-terminal, which carries the board's serial port. Each line of the standard input is
   the number of counts that the amplifier measures from then on, with a little noise, or "off", which unplugs its data wire. The program
   ends with its standard input. The emulated time keeps pace with the clock on the wall, if the machine is fast enough.

   The amplifier follows its data sheet: the data line falls when a sample is ready (80 per second), each rising edge of
   the clock shifts out one bit, beginning with the highest, and the 25th edge ends the sample. A clock that stays high for
   60 microseconds switches it off until the clock has fallen; the next sample then takes 50 ms. */
#define _XOPEN_SOURCE 600
#define _DEFAULT_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_time.h>

enum { HERTZ = 16000000, PERIOD_US = 12500, SETTLING_US = 50000, OFF_US = 60, PULSES = 25 };

static avr_t *avr;
static avr_irq_t *data_line;
static int terminal;
static int32_t counts;
static int plugged = 1, pulses;
static uint32_t bits;
static avr_cycle_count_t rose_at;

/* simavr sets an input with a pull-up to 1 whenever its port is written, unless an external level is stated too. */
static void show(int level) {
  unsigned high = level || !plugged;
  avr_ioport_external_t outside = {.name = 'D', .mask = 1u << 3, .value = high << 3};
  avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &outside);
  avr_raise_irq(data_line, high);
}

static avr_cycle_count_t ready(struct avr_t *board, avr_cycle_count_t when, void *unused) {
  (void)unused;
  /* Noise of up to 8 counts, whose mean is 0 over 17 samples; the converter saturates at 24 bits. */
  static int32_t sample;
  int32_t value = counts + (++sample * 7 % 17 - 8);
  if (value > 0x7FFFFF) value = 0x7FFFFF;
  if (value < -0x800000) value = -0x800000;
  bits = (uint32_t)value & 0xFFFFFF;
  pulses = 0;
  show(0);
  return when + avr_usec_to_cycles(board, PERIOD_US);
}

static void restart(uint32_t after_us) {
  avr_cycle_timer_cancel(avr, ready, NULL);
  avr_cycle_timer_register_usec(avr, after_us, ready, NULL);
}

static void clock_changed(struct avr_irq_t *irq, uint32_t level, void *unused) {
  (void)irq, (void)unused;
  if (level) {
    rose_at = avr->cycle;
    ++pulses;
    show(pulses < PULSES ? bits >> (24 - pulses) & 1 : 1);
  } else if (avr->cycle - rose_at >= avr_usec_to_cycles(avr, OFF_US)) {
    show(1);
    restart(SETTLING_US);
  }
}

static void sent(struct avr_irq_t *irq, uint32_t byte, void *unused) {
  (void)irq, (void)unused;
  char c = (char)byte;
  if (write(terminal, &c, 1) < 0 && errno != EIO && errno != EAGAIN) exit(1);
}

/* Read what the test has written, without waiting. Return 0 at the end of the input. */
static int obey(void) {
  static char line[64];
  static size_t length;
  char c;
  ssize_t count;
  while ((count = read(STDIN_FILENO, &c, 1)) == 1) {
    if (c != '\n') {
      if (length + 1 < sizeof line) line[length++] = c;
      continue;
    }
    line[length] = 0, length = 0;
    plugged = strcmp(line, "off") != 0;
    counts = plugged ? (int32_t)strtol(line, NULL, 10) : 0;
    if (!plugged) show(1);
  }
  return count != 0;
}

static double seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int argc, char **argv) {
  elf_firmware_t firmware = {0};
  if (argc != 2 || elf_read_firmware(argv[1], &firmware)) return 2;
  avr = avr_make_mcu_by_name("atmega328p");
  if (!avr || avr_init(avr)) return 2;
  avr->log = LOG_NONE;
  firmware.frequency = HERTZ;
  avr_load_firmware(avr, &firmware);
  avr->frequency = HERTZ;

  terminal = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (terminal < 0 || grantpt(terminal) || unlockpt(terminal)) return 2;
  /* An open end keeps the terminal alive while no program has it open. */
  int kept = open(ptsname(terminal), O_RDWR | O_NOCTTY);
  struct termios raw;
  tcgetattr(kept, &raw), cfmakeraw(&raw), tcsetattr(kept, TCSANOW, &raw);
  printf("%s\n", ptsname(terminal)), fflush(stdout);
  fcntl(STDIN_FILENO, F_SETFL, O_NONBLOCK);

  uint32_t flags = 0;
  avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
  flags &= ~(uint32_t)AVR_UART_FLAG_STDIO;
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), sent, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 2), clock_changed, NULL);
  data_line = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 3);
  show(1);
  restart(SETTLING_US);

  double start = seconds();
  avr_cycle_count_t next = 0;
  for (;;) {
    int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) return 1;
    if (avr->cycle < next) continue;
    next = avr->cycle + HERTZ / 1000;
    if (!obey()) return 0;
    double ahead = (double)avr->cycle / HERTZ - (seconds() - start);
    if (ahead > 0.001) usleep((useconds_t)(1e6 * ahead));
  }
}
