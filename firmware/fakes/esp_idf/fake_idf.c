/* The peripherals of an ESP32, as far as the port uses them, on a clock that stands still until it is told to run; driven as
 * fakes/script.c is (rx HEX, run NS). Also: fail 1 makes the next write of the store fail.
 *
 * The RMT: a memory of S symbols, filled at the start; whenever half of it has been sent, the encoder's callback writes that
 * half anew (in no time at all: how late a real interrupt is, is not modelled, only that it has half a memory's time). A symbol
 * is two levels with 15 bits of ticks each; a length of nothing ends the transmission, which here is a crash.
 *
 * A stop: C3 and S3 stop at once. The ESP32 cannot: its driver (esp_driver_rmt/src/rmt_tx.c) writes such an end into the first
 * place of the memory and waits, with interrupts off, until the peripheral comes round to it; all that lies before is sent.
 */
#include "fake_idf.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#define NS_PER_MS 1000000u
#define NS_PER_S 1000000000u
#define MEMORY_MOST 64u
#define DIVIDER_MOST 256u
#define LINE_MOST 4096
#define STORE_MOST 256u

struct fake_encoder {
    rmt_simple_encoder_config_t config;
};
struct fake_channel {
    rmt_tx_channel_config_t config;
    const struct fake_encoder *encoder;
    rmt_symbol_word_t memory[MEMORY_MOST];
    size_t at, written;
    uint64_t next_ticks; /* when the symbol on the air ends */
    bool enabled, sending;
};

static struct fake_channel rmt;
static struct fake_encoder encoder;
static uint64_t now_ns, run_until_ns;
static bool lit, fails;
static uint8_t store[STORE_MOST];
static size_t store_n;

static void tell(uint64_t ticks, bool level)
{
    if (level != lit) {
        printf("edge %" PRIu64 ",%d\n", ticks * (NS_PER_S / rmt.config.resolution_hz), level ? 1 : 0);
    }
    lit = level;
}

static void refill(size_t from, size_t size)
{
    bool done = false;
    const size_t n =
        rmt.encoder->config.callback(0, 0, rmt.written, size, rmt.memory + from, &done, rmt.encoder->config.arg);
    rmt.written += n;
    if (n != size || done) {
        fprintf(stderr, "fake RMT: the encoder left a gap\n");
        abort();
    }
}

static void send_symbol(bool interrupts)
{
    const uint32_t word = rmt.memory[rmt.at].val;
    const uint32_t first = word & 0x7FFFu;
    const uint32_t second = (word >> 16) & 0x7FFFu;
    if (first == 0 || second == 0) {
        fprintf(stderr, "fake RMT: a length of nothing ends the transmission\n");
        abort();
    }
    tell(rmt.next_ticks, (word & 0x8000u) != 0);
    tell(rmt.next_ticks + first, (word & 0x80000000u) != 0);
    rmt.next_ticks += first + second;
    const size_t half = rmt.config.mem_block_symbols / 2;
    rmt.at = rmt.at + 1 == 2 * half ? 0 : rmt.at + 1;
    if (interrupts && rmt.at % half == 0) {
        refill(rmt.at == 0 ? half : 0, half);
    }
}

static uint64_t tick_ns(void)
{
    return rmt.config.resolution_hz != 0 ? NS_PER_S / rmt.config.resolution_hz : 1;
}

static void run_to(uint64_t end_ns)
{
    while (rmt.sending && rmt.next_ticks * tick_ns() <= end_ns) {
        send_symbol(true);
    }
    now_ns = end_ns;
}

esp_err_t rmt_new_tx_channel(const rmt_tx_channel_config_t *config, rmt_channel_handle_t *channel)
{
    const uint32_t divider = FAKE_RMT_CLOCK_HZ / config->resolution_hz;
    const size_t symbols = config->mem_block_symbols;
    rmt.config = *config;
    *channel = &rmt;
    /* The driver rounds a divider that is no whole number; then ticks are not what the port takes them for. */
    if (divider < 1 || divider > DIVIDER_MOST || divider * config->resolution_hz != FAKE_RMT_CLOCK_HZ) {
        return ESP_FAIL;
    }
    return symbols % 2 == 0 && symbols >= SOC_RMT_MEM_WORDS_PER_CHANNEL && symbols <= MEMORY_MOST ? ESP_OK : ESP_FAIL;
}

esp_err_t rmt_new_simple_encoder(const rmt_simple_encoder_config_t *config, rmt_encoder_handle_t *made)
{
    encoder.config = *config;
    *made = &encoder;
    return ESP_OK;
}

esp_err_t rmt_encoder_reset(rmt_encoder_handle_t which)
{
    return which == &encoder ? ESP_OK : ESP_FAIL;
}

esp_err_t rmt_enable(rmt_channel_handle_t channel)
{
    if (channel->enabled) {
        return ESP_FAIL;
    }
    channel->enabled = true;
    return ESP_OK;
}

esp_err_t rmt_disable(rmt_channel_handle_t channel)
{
    if (!channel->enabled) {
        return ESP_FAIL;
    }
    if (channel->sending && FAKE_STOPS_AT_ONCE) {
        tell(now_ns / tick_ns(), false);
    } else if (channel->sending) {
        channel->memory[0].val = 0;
        while (channel->at != 0) {
            send_symbol(false);
        }
        const uint64_t end_ns = channel->next_ticks * tick_ns();
        printf("waited %" PRIu64 "\n", end_ns > now_ns ? end_ns - now_ns : 0);
        now_ns = end_ns > now_ns ? end_ns : now_ns;
        tell(channel->next_ticks, false);
    }
    channel->enabled = false;
    channel->sending = false;
    return ESP_OK;
}

esp_err_t rmt_transmit(rmt_channel_handle_t channel, rmt_encoder_handle_t with, const void *data, size_t size,
                       const rmt_transmit_config_t *config)
{
    if (!channel->enabled || data == 0 || size == 0 || config->loop_count != 0) {
        return ESP_FAIL;
    }
    channel->next_ticks = (now_ns + tick_ns() - 1) / tick_ns();
    channel->encoder = with;
    channel->at = 0;
    channel->written = 0;
    channel->sending = true;
    refill(0, channel->config.mem_block_symbols); /* the driver fills all of it at once */
    return ESP_OK;
}

esp_err_t rmt_apply_carrier(rmt_channel_handle_t channel, const rmt_carrier_config_t *config)
{
    (void)channel;
    printf("power %d\n", config == 0 ? 1000 : (int)(config->duty_cycle * 1000.0f + 0.5f));
    return ESP_OK;
}

esp_err_t uart_driver_install(int port, int in, int out, int queue, void *handle, int flags)
{
    (void)handle;
    return port == UART_NUM_0 && in > 128 && out > 128 && queue == 0 && flags == 0 ? ESP_OK : ESP_FAIL;
}

esp_err_t uart_param_config(int port, const uart_config_t *config)
{
    return port == UART_NUM_0 && config->baud_rate == 115200 ? ESP_OK : ESP_FAIL;
}

esp_err_t uart_get_tx_buffer_free_size(int port, size_t *room)
{
    *room = 1024;
    return port == UART_NUM_0 ? ESP_OK : ESP_FAIL;
}

int uart_write_bytes(int port, const void *bytes, size_t n)
{
    (void)port;
    printf("tx ");
    for (size_t i = 0; i < n; i++) {
        printf("%02x", ((const uint8_t *)bytes)[i]);
    }
    printf("\n");
    return (int)n;
}

/* The port waits here: time passes while there is some to pass; otherwise the next command is read and obeyed. */
int uart_read_bytes(int port, void *bytes, uint32_t most, uint32_t ticks)
{
    static char line[LINE_MOST];
    static const char *rest = "";
    unsigned byte;
    uint32_t n = 0;
    (void)port;
    (void)ticks;
    for (; n < most && sscanf(rest, "%2x", &byte) == 1; rest += 2) {
        ((uint8_t *)bytes)[n++] = (uint8_t)byte;
    }
    if (n > 0) {
        return (int)n;
    }
    if (now_ns < run_until_ns) {
        run_to(now_ns + NS_PER_MS < run_until_ns ? now_ns + NS_PER_MS : run_until_ns);
        return 0;
    }
    printf("now %" PRIu64 "\n.\n", now_ns);
    (void)fflush(stdout);
    if (fgets(line, sizeof line, stdin) == 0) {
        exit(0);
    }
    if (strncmp(line, "rx ", 3) == 0) {
        rest = line + 3;
    } else if (strncmp(line, "run ", 4) == 0) {
        run_until_ns = now_ns + strtoull(line + 4, 0, 10);
    } else if (strncmp(line, "fail ", 5) == 0) {
        fails = line[5] == '1';
    }
    return 0;
}

esp_err_t nvs_flash_init(void)
{
    return ESP_OK;
}

esp_err_t nvs_flash_erase(void)
{
    store_n = 0;
    return ESP_OK;
}

esp_err_t nvs_open(const char *space, int mode, nvs_handle_t *handle)
{
    *handle = mode;
    return strlen(space) <= 15 && (mode == NVS_READWRITE || store_n > 0) ? ESP_OK : ESP_ERR_NVS_NOT_FOUND;
}

esp_err_t nvs_set_blob(nvs_handle_t handle, const char *key, const void *bytes, size_t n)
{
    if (handle != NVS_READWRITE || strlen(key) > 15 || n > STORE_MOST || fails) {
        return ESP_FAIL;
    }
    memcpy(store, bytes, n);
    store_n = n;
    return ESP_OK;
}

esp_err_t nvs_get_blob(nvs_handle_t handle, const char *key, void *bytes, size_t *n)
{
    (void)handle;
    (void)key;
    if (store_n == 0 || store_n > *n) {
        return ESP_FAIL;
    }
    memcpy(bytes, store, store_n);
    *n = store_n;
    return ESP_OK;
}

esp_err_t nvs_commit(nvs_handle_t handle)
{
    printf("kept ");
    for (size_t i = 0; i < store_n; i++) {
        printf("%02x", store[i]);
    }
    printf("\n");
    return handle == NVS_READWRITE ? ESP_OK : ESP_FAIL;
}

void nvs_close(nvs_handle_t handle)
{
    (void)handle;
}

int esp_reset_reason(void)
{
    return ESP_RST_POWERON;
}

void esp_restart(void)
{
    fprintf(stderr, "fake ESP32: restarted\n");
    exit(3);
}

uint32_t esp_random(void)
{
    return 0x12340000u;
}

esp_err_t esp_efuse_mac_get_default(uint8_t *mac)
{
    static const uint8_t own[6] = {0x24, 0x6F, 0x28, 1, 2, 3};
    memcpy(mac, own, sizeof own);
    return ESP_OK;
}

int64_t esp_timer_get_time(void)
{
    return (int64_t)(now_ns / 1000);
}

esp_err_t esp_task_wdt_add(void *task)
{
    return task == 0 ? ESP_OK : ESP_FAIL;
}

esp_err_t esp_task_wdt_reset(void)
{
    return ESP_OK;
}

int main(void)
{
    app_main();
    return 0;
}
