// Drives node 1 with the npm package `canopen`, over the slcan port that is the first argument; prints what came back.
const fs = require('fs');
const tty = require('tty');
const { Device, DataType } = require('canopen');

const fd = fs.openSync(process.argv[2], fs.constants.O_RDWR | fs.constants.O_NOCTTY);
const port = new tty.ReadStream(fd);
const device = new Device({ id: 0x7f });
let rest = '';

device.addListener('message', ({ id, data }) => {
    const hex = Buffer.from(data).toString('hex').toUpperCase();
    fs.writeSync(fd, `t${id.toString(16).padStart(3, '0')}${data.length}${hex}\r`);
});
port.on('data', (chunk) => {
    const lines = (rest + chunk.toString('ascii')).split(/[\r\x07]/);
    rest = lines.pop();
    for (const line of lines.filter((text) => text.startsWith('t'))) {
        const length = parseInt(line[4], 16);
        const data = Buffer.from(line.slice(5, 5 + 2 * length), 'hex');
        device.receive({ id: parseInt(line.slice(1, 4), 16), data });
    }
});
fs.writeSync(fd, 'S8\rO\r');

const where = (index, subIndex) => ({ serverId: 1, index, subIndex, timeout: 2000 });
const read = (index, subIndex, dataType) => device.sdo.upload({ ...where(index, subIndex), dataType });
const write = (index, subIndex, data, dataType) => device.sdo.download({ ...where(index, subIndex), data, dataType });
const statusword = () => read(0x6041, 0, DataType.UNSIGNED16);
const command = (word) => write(0x6040, 0, word, DataType.UNSIGNED16);
const refusal = (attempt) => attempt.then(() => null, (error) => error.code);

async function until(done) {
    for (let tries = 0; tries < 1000; tries += 1) {
        if (done(await statusword())) return;
        await new Promise((resolve) => setTimeout(resolve, 5));
    }
    throw new Error('the drive did not get there');
}

async function move(target) {
    await write(0x607a, 0, target, DataType.INTEGER32);
    await command(0x3f);
    await until((word) => word & 0x1000);
    await command(0x0f);
}

async function main() {
    const answer = {};
    device.eds.addSdoClientParameter(1, 0x601, 0x581);
    device.eds.addEmcyConsumer(0x81);
    const emergency = new Promise((resolve) => {
        device.emcy.on('emergency', ({ em }) => resolve(em.code));
    });
    device.start();
    device.nmt.startNode(1);
    answer.vendor = await read(0x1018, 1, DataType.UNSIGNED32);
    for (const [word, bits] of [[0x06, 0x21], [0x07, 0x23], [0x0f, 0x27]]) {
        await command(word);
        await until((status) => (status & 0x6f) === bits);
    }
    await write(0x6081, 0, 3000, DataType.UNSIGNED32);
    await move(20000);
    await until((word) => word & 0x0400);
    answer.position = await read(0x6064, 0, DataType.INTEGER32);
    answer.noSuchObject = await refusal(read(0x4000, 0, DataType.UNSIGNED8));
    answer.tooLow = await refusal(write(0x6081, 0, 0, DataType.UNSIGNED32));
    await write(0x607d, 2, 30000, DataType.INTEGER32);
    await move(90000);
    answer.emergency = await emergency;
    await until((word) => (word & 0x4f) === 0x08);
    console.log(JSON.stringify(answer));
    process.exit(0);
}

main().catch((error) => {
    console.error(error);
    process.exit(1);
});
