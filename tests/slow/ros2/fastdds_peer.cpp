// Debian's Fast DDS 2.9, as close to Humble's as packages come: it announces no type hashes. Takes clouds and keeps their
// bytes, which the test decodes.
//
// fastdds_peer DOMAIN TOPIC...: on standard output a line of JSON for each message, and its bytes behind.
// fastdds_peer DOMAIN publish TOPIC QUALITY BYTES...: bytes of clouds 20 times a second, the first of them a number from 1 on.

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <fcntl.h>
#include <unistd.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;

using Bytes = std::vector<unsigned char>;

// A cloud whose bytes stay as they came.
class RawCloud : public TopicDataType {
public:
    RawCloud() {
        m_typeSize = 1024;
        m_isGetKeyDefined = false;
        setName("sensor_msgs::msg::dds_::PointCloud2_");
    }
    bool serialize(void* data, SerializedPayload_t* payload) override {
        const auto& bytes = *static_cast<Bytes*>(data);
        payload->length = bytes.size();
        std::copy(bytes.begin(), bytes.end(), payload->data);
        return true;
    }
    bool deserialize(SerializedPayload_t* payload, void* data) override {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
        return [data] { return uint32_t(static_cast<Bytes*>(data)->size()); };
    }
    void* createData() override { return new Bytes; }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

// A message, told by a thread of its own: what receives must not wait for who reads the output.
struct Message {
    std::string head;
    Bytes bytes;
};

class Output {
public:
    void add(Message message) {
        const std::lock_guard<std::mutex> lock(mutex_);
        messages_.push_back(std::move(message));
        came_.notify_one();
    }

    void run() {
        for (;;) {
            std::unique_lock<std::mutex> lock(mutex_);
            came_.wait(lock, [this] { return !messages_.empty(); });
            const Message message = std::move(messages_.front());
            messages_.pop_front();
            lock.unlock();
            std::printf("%s, \"bytes\": %zu}\n", message.head.c_str(), message.bytes.size());
            std::fwrite(message.bytes.data(), 1, message.bytes.size(), stdout);
            std::fflush(stdout);
        }
    }

private:
    std::mutex mutex_;
    std::condition_variable came_;
    std::deque<Message> messages_;
};

class Teller : public DataReaderListener {
public:
    Teller(Output& output, const std::string& topic, const std::string& quality)
        : output_(output), head_("{\"raw\": true, \"topic\": \"" + topic + "\", \"quality\": \"" + quality + "\"") {}

    void on_data_available(DataReader* reader) override {
        SampleInfo info;
        Bytes bytes;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
            if (info.valid_data) output_.add({head_, std::move(bytes)});
        }
    }

private:
    Output& output_;
    std::string head_;
};

// What is behind "publish" on the command line, for ever.
void publish(DomainParticipant* participant, const TypeSupport& type, int argc, char** argv) {
    std::vector<std::pair<DataWriter*, size_t>> writers;
    auto* publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    for (int i = 3; i + 2 < argc; i += 3) {
        auto* topic = participant->create_topic(std::string("rt") + argv[i], type.get_type_name(), TOPIC_QOS_DEFAULT);
        DataWriterQos how = DATAWRITER_QOS_DEFAULT;
        how.reliability().kind =
            argv[i + 1] == std::string("reliable") ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
        how.history().kind = KEEP_LAST_HISTORY_QOS;
        how.history().depth = 5;
        how.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;
        how.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
        writers.emplace_back(publisher->create_datawriter(topic, how), std::atoi(argv[i + 2]));
    }
    for (uint32_t number = 1;; ++number) {
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
        for (const auto& [writer, size] : writers) {
            // Encapsulation, the number, and bytes of it.
            Bytes bytes(4 + 4 + size, uint8_t(number));
            const uint8_t head[] = {0, 1, 0, 0};
            std::copy(head, head + 4, bytes.begin());
            std::memcpy(&bytes[4], &number, 4);
            writer->write(&bytes);
        }
    }
}

int main(int argc, char** argv) {
    if (argc < 3) return 2;
    // Large pieces of a cloud at a time.
    fcntl(STDOUT_FILENO, F_SETPIPE_SZ, 1 << 20);
    DomainParticipantQos qos;
    qos.name("reader");
    // Loopback alone, and no shared memory, which other versions on this host use in ways of their own.
    const auto loopback = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    loopback->interfaceWhiteList.push_back("127.0.0.1");
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(loopback);
    auto* participant = DomainParticipantFactory::get_instance()->create_participant(std::atoi(argv[1]), qos);
    if (!participant) return 1;
    TypeSupport type(new RawCloud);
    type.register_type(participant);
    if (argv[2] == std::string("publish")) {
        std::printf("{\"ready\": true}\n");
        std::fflush(stdout);
        publish(participant, type, argc, argv);
    }
    auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    Output output;
    std::vector<std::unique_ptr<Teller>> tellers;
    for (int i = 2; i < argc; ++i) {
        auto* topic = participant->create_topic(std::string("rt") + argv[i], type.get_type_name(), TOPIC_QOS_DEFAULT);
        for (const bool reliable : {false, true}) {
            DataReaderQos how = DATAREADER_QOS_DEFAULT;
            how.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
            how.history().kind = KEEP_LAST_HISTORY_QOS;
            how.history().depth = 50;
            // Clouds differ in size.
            how.endpoint().history_memory_policy =
                eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
            tellers.push_back(std::make_unique<Teller>(output, argv[i], reliable ? "reliable" : "best_effort"));
            if (!subscriber->create_datareader(topic, how, tellers.back().get())) return 1;
        }
    }
    std::printf("{\"ready\": true}\n");
    std::fflush(stdout);
    // The test ends it.
    output.run();
}
