#include "rmt_light.h"

#include "driver/rmt_encoder.h"
#include "driver/rmt_tx.h"
#include "esp_attr.h"
#include "soc/soc_caps.h"

#define SYMBOL_TICKS 2000u
/* What the memory is filled with to end a transmission: dark, 2 us, so that all of it has gone by in 0.13 ms. */
#define DARK_SYMBOL (10u | 10u << 16)
#define POWER_FULL 1000u
/* Far above what a pixel follows (some kHz), and 400 steps of duty at the peripheral's 80 MHz. */
#define CARRIER_HZ 200000u
#define LEVEL_BIT 0x8000u

typedef struct {
    hg_pump *pump;
    rmt_channel_handle_t channel;
    rmt_encoder_handle_t encoder;
    uint32_t left_ticks; /* of the bit that is being cut up */
    bool lit;
    volatile uint16_t power; /* of the bit that was asked for last */
    uint16_t set_power;
    bool running;
    volatile rmt_symbol_word_t *memory; /* the peripheral's own: where the first symbol was written to */
    volatile bool ending;
} light;

static light self;

static uint32_t IRAM_ATTR next_symbol(light *of)
{
    if (of->left_ticks == 0u) {
        const hg_bit bit = hg_pump_next(of->pump);
        of->left_ticks = bit.ticks;
        of->lit = bit.lit;
        if (bit.power != 0u) {
            of->power = bit.power;
        }
    }
    uint32_t ticks = of->left_ticks;
    if (ticks > 2u * SYMBOL_TICKS) {
        ticks = SYMBOL_TICKS;
    } else if (ticks > SYMBOL_TICKS) {
        ticks >>= 1;
    }
    of->left_ticks -= ticks;
    const uint32_t first = ticks >> 1;
    const uint32_t level = of->lit ? LEVEL_BIT : 0u;
    return (level | first) | ((level | (ticks - first)) << 16);
}

/* Called in the interrupt: half of the memory has been sent. Whole words only: the peripheral reads while this writes. */
static size_t IRAM_ATTR fill(const void *data, size_t size, size_t written, size_t free, rmt_symbol_word_t *symbols,
                             bool *done, void *context)
{
    (void)data;
    (void)size;
    light *const of = context;
    *done = false;
    if (written == 0u) {
        of->memory = symbols;
    }
    for (size_t i = 0; i < free; i++) {
        symbols[i].val = of->ending ? DARK_SYMBOL : next_symbol(of);
    }
    return free;
}

bool rmt_light_open(hg_pump *pump, int gpio)
{
    const rmt_tx_channel_config_t channel = {
        .gpio_num = gpio,
        .clk_src = RMT_CLK_SRC_DEFAULT,
        .resolution_hz = RMT_TICKS_PER_S,
        .mem_block_symbols = SOC_RMT_MEM_WORDS_PER_CHANNEL,
        .trans_queue_depth = 1,
    };
    const rmt_simple_encoder_config_t encoder = {.callback = fill, .arg = &self, .min_chunk_size = 1};
    self = (light){.pump = pump, .set_power = POWER_FULL, .power = POWER_FULL};
    return rmt_new_tx_channel(&channel, &self.channel) == ESP_OK
           && rmt_new_simple_encoder(&encoder, &self.encoder) == ESP_OK;
}

static bool start(void)
{
    static const uint8_t nothing = 0; /* the encoder makes its own data; the driver wants some */
    const rmt_transmit_config_t once = {.loop_count = 0, .flags = {.eot_level = 0}};
    self.left_ticks = 0;
    self.ending = false;
    if (rmt_encoder_reset(self.encoder) != ESP_OK || rmt_enable(self.channel) != ESP_OK) {
        return false;
    }
    self.running = rmt_transmit(self.channel, self.encoder, &nothing, sizeof nothing, &once) == ESP_OK;
    return self.running || (rmt_disable(self.channel) == ESP_OK && false);
}

/* An ESP32 cannot stop: its driver marks an end at the memory's beginning and waits for it with interrupts off, 12.8 ms of light
 * at worst. So all symbols that wait are made dark and short first: what is on the air ends within a symbol, the wait in 0.4 ms. */
static bool stop(void)
{
    self.ending = true;
    for (size_t i = 0; i < SOC_RMT_MEM_WORDS_PER_CHANNEL; i++) {
        self.memory[i].val = DARK_SYMBOL;
    }
    if (rmt_disable(self.channel) != ESP_OK) {
        return false;
    }
    self.running = false;
    hg_pump_halt(self.pump); /* no interrupt can ask it any more */
    return true;
}

static bool set_power(uint16_t power)
{
    const rmt_carrier_config_t carrier = {.frequency_hz = CARRIER_HZ, .duty_cycle = (float)power / (float)POWER_FULL};
    self.set_power = power;
    return rmt_apply_carrier(self.channel, power == POWER_FULL ? 0 : &carrier) == ESP_OK;
}

bool rmt_light_follow(bool armed)
{
    bool fine = true;
    if (armed != self.running) {
        fine = armed ? start() : stop();
    }
    const uint16_t power = self.power;
    return power == self.set_power ? fine : set_power(power) && fine;
}
