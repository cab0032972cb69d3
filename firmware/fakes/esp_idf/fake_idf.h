/* As much of ESP-IDF 5.5's interface as ports/esp32 uses, declared anew for a host: names and meanings are Espressif's (its
 * API reference), the code behind them is a model of ours (fake_idf.c). The headers beside it forward here. */
#ifndef FAKE_IDF_H
#define FAKE_IDF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

typedef int esp_err_t;
#define ESP_OK 0
#define ESP_FAIL (-1)
#define ESP_ERR_NVS_NOT_FOUND 0x1102
#define ESP_ERR_NVS_NO_FREE_PAGES 0x110D
#define ESP_ERR_NVS_NEW_VERSION_FOUND 0x1110
#define ESP_ERROR_CHECK(call) ((call) == ESP_OK ? (void)0 : abort())
#define IRAM_ATTR

#define CONFIG_HELIOGRAPH_LED_GPIO 4
/* What differs between the chips (soc_caps.h and clk_tree_defs.h of ESP-IDF): symbols that a channel's memory holds, the clock
 * that RMT_CLK_SRC_DEFAULT stands for, and whether a transmission can be stopped at once. */
#if defined FAKE_ESP32C3
#define CONFIG_IDF_TARGET "esp32c3"
#elif defined FAKE_ESP32S3
#define CONFIG_IDF_TARGET "esp32s3"
#else
#define CONFIG_IDF_TARGET "esp32"
#endif
#if defined FAKE_ESP32C3 || defined FAKE_ESP32S3
#define SOC_RMT_MEM_WORDS_PER_CHANNEL 48
#define FAKE_STOPS_AT_ONCE true
#else
#define SOC_RMT_MEM_WORDS_PER_CHANNEL 64
#define FAKE_STOPS_AT_ONCE false
#endif
#define FAKE_RMT_CLOCK_HZ 80000000u

typedef struct fake_channel *rmt_channel_handle_t;
typedef struct fake_encoder *rmt_encoder_handle_t;
typedef union {
    uint32_t val;
} rmt_symbol_word_t;
typedef size_t (*rmt_encode_simple_cb_t)(const void *data, size_t size, size_t written, size_t free,
                                         rmt_symbol_word_t *symbols, bool *done, void *arg);
typedef struct {
    rmt_encode_simple_cb_t callback;
    void *arg;
    size_t min_chunk_size;
} rmt_simple_encoder_config_t;
enum { RMT_CLK_SRC_DEFAULT };
typedef struct {
    int gpio_num, clk_src;
    uint32_t resolution_hz;
    size_t mem_block_symbols, trans_queue_depth;
} rmt_tx_channel_config_t;
typedef struct {
    int loop_count;
    struct {
        uint32_t eot_level;
    } flags;
} rmt_transmit_config_t;
typedef struct {
    uint32_t frequency_hz;
    float duty_cycle;
} rmt_carrier_config_t;
esp_err_t rmt_new_tx_channel(const rmt_tx_channel_config_t *config, rmt_channel_handle_t *channel);
esp_err_t rmt_new_simple_encoder(const rmt_simple_encoder_config_t *config, rmt_encoder_handle_t *encoder);
esp_err_t rmt_encoder_reset(rmt_encoder_handle_t encoder);
esp_err_t rmt_enable(rmt_channel_handle_t channel);
esp_err_t rmt_disable(rmt_channel_handle_t channel);
esp_err_t rmt_transmit(rmt_channel_handle_t channel, rmt_encoder_handle_t encoder, const void *data, size_t size,
                       const rmt_transmit_config_t *config);
esp_err_t rmt_apply_carrier(rmt_channel_handle_t channel, const rmt_carrier_config_t *config);

enum { UART_NUM_0, UART_DATA_8_BITS, UART_PARITY_DISABLE, UART_STOP_BITS_1, UART_HW_FLOWCTRL_DISABLE };
typedef struct {
    int baud_rate, data_bits, parity, stop_bits, flow_ctrl;
} uart_config_t;
esp_err_t uart_driver_install(int port, int in, int out, int queue, void *handle, int flags);
esp_err_t uart_param_config(int port, const uart_config_t *config);
esp_err_t uart_get_tx_buffer_free_size(int port, size_t *room);
int uart_write_bytes(int port, const void *bytes, size_t n);
int uart_read_bytes(int port, void *bytes, uint32_t most, uint32_t ticks);

typedef int nvs_handle_t;
enum { NVS_READONLY, NVS_READWRITE };
esp_err_t nvs_flash_init(void);
esp_err_t nvs_flash_erase(void);
esp_err_t nvs_open(const char *space, int mode, nvs_handle_t *store);
esp_err_t nvs_set_blob(nvs_handle_t store, const char *key, const void *bytes, size_t n);
esp_err_t nvs_get_blob(nvs_handle_t store, const char *key, void *bytes, size_t *n);
esp_err_t nvs_commit(nvs_handle_t store);
void nvs_close(nvs_handle_t store);

enum { ESP_RST_UNKNOWN, ESP_RST_POWERON, ESP_RST_SW, ESP_RST_INT_WDT, ESP_RST_TASK_WDT, ESP_RST_WDT };
int esp_reset_reason(void);
void esp_restart(void);
uint32_t esp_random(void);
esp_err_t esp_efuse_mac_get_default(uint8_t *mac);
int64_t esp_timer_get_time(void);
esp_err_t esp_task_wdt_add(void *task);
esp_err_t esp_task_wdt_reset(void);

void app_main(void);

#endif
